/* Drives a LED or a motor from a face: AVR boards (Uno, Nano, Mega), ESP32, anything with the Arduino core.
 *
 * 1. In mien's configuration: [serial] port = "/dev/serial/by-id/...", units = ["AU26"]; any style, baud = 115200.
 * 2. Choose the unit below: its place in `units`, from 0.
 * 3. Upload, and close the serial monitor: the port is mien's.
 */
#include "mien.h"

/* Which weight drives the pin. */
#ifndef MIEN_UNIT
#define MIEN_UNIT 0
#endif
/* 1: each frame's number, state and value are printed, and the count of rejected frames. */
#ifndef MIEN_PRINT
#define MIEN_PRINT 0
#endif

const int PIN = 9;  /* one that can do PWM */
/* With nothing heard for so long the pin goes to rest. */
const unsigned long SILENCE_MS = 1000;

mien::Reader face;
unsigned long heard = 0;

void setup() {
#ifdef ESP32
  Serial.setRxBufferSize(256);  /* before begin */
#endif
  Serial.begin(115200);
  pinMode(PIN, OUTPUT);
}

void loop() {
  while (Serial.available()) {
    if (!face.feed(Serial.read())) continue;
    heard = millis();
    bool somebody = face.state != mien::ABSENT && face.count > MIEN_UNIT;
    int value = somebody ? face.weights[MIEN_UNIT] : 0;
    analogWrite(PIN, value);
#if MIEN_PRINT
    Serial.print(face.number);
    Serial.print(' ');
    Serial.print(face.state);
    Serial.print(' ');
    Serial.print(value);
    Serial.print(' ');
    Serial.println(face.rejected);
#endif
  }
  if (millis() - heard > SILENCE_MS) analogWrite(PIN, 0);
}
