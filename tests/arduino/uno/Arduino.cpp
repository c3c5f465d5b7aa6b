#include "Arduino.h"

#include <avr/interrupt.h>

static volatile uint8_t ring[64];
static volatile uint8_t head, tail;

ISR(USART_RX_vect) {
  uint8_t byte = UDR0;
  uint8_t next = (head + 1) & 63;
  if (next != tail) {
    ring[head] = byte;
    head = next;
  }
}

void SerialPort::begin(uint32_t baud) {
  UCSR0A = _BV(U2X0);
  UBRR0 = (F_CPU / 4 / baud - 1) / 2;
  UCSR0B = _BV(RXEN0) | _BV(TXEN0) | _BV(RXCIE0);
  sei();
}

uint8_t SerialPort::available() { return (head - tail) & 63; }

uint8_t SerialPort::read() {
  uint8_t byte = ring[tail];
  tail = (tail + 1) & 63;
  return byte;
}

void SerialPort::print(char byte) {
  while (!(UCSR0A & _BV(UDRE0))) {}
  UDR0 = byte;
}

void SerialPort::print(uint32_t number) {
  char digits[10];
  uint8_t n = 0;
  do digits[n++] = '0' + number % 10;
  while (number /= 10);
  while (n) print(digits[--n]);
}

void SerialPort::println(uint16_t number) {
  print(number);
  print('\n');
}

SerialPort Serial;

void pinMode(int, int) { DDRB |= _BV(PB1); }

/* Pin 9 is the output A of timer 1: fast PWM of 8 bits. */
void analogWrite(int, int value) {
  TCCR1A = _BV(COM1A1) | _BV(WGM10);
  TCCR1B = _BV(WGM12) | _BV(CS11);
  OCR1A = value;
}

/* Timer 0 counts milliseconds: 16 MHz / 64 / 250. */
static volatile unsigned long milliseconds;

ISR(TIMER0_COMPA_vect) { milliseconds++; }

unsigned long millis() {
  uint8_t status = SREG;
  cli();
  unsigned long now = milliseconds;
  SREG = status;
  return now;
}

int main() {
  TCCR0A = _BV(WGM01);
  TCCR0B = _BV(CS01) | _BV(CS00);
  OCR0A = 249;
  TIMSK0 = _BV(OCIE0A);
  sei();
  setup();
  for (;;) loop();
}
