/* As much of the Arduino core as the sketch uses, for an ATmega328P at 16 MHz: the sketch is compiled unchanged. */
#pragma once
#include <avr/io.h>
#include <stdint.h>

#define OUTPUT 1

void pinMode(int pin, int mode);
void analogWrite(int pin, int value);
unsigned long millis();

/* The serial port with a ring of 64 bytes filled by the interrupt, as in the Arduino core. What finds it full is lost. */
class SerialPort {
 public:
  void begin(uint32_t baud);
  uint8_t available();
  uint8_t read();
  void print(char byte);
  void print(uint8_t number) { print((uint32_t)number); }
  void print(uint16_t number) { print((uint32_t)number); }
  void print(int number) { print((uint32_t)number); }
  void print(uint32_t number);
  void println(uint16_t number);
};
extern SerialPort Serial;

void setup();
void loop();
