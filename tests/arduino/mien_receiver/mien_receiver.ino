/* Drives a LED or a servo from a face: AVR boards (Uno, Nano, Mega), ESP32, anything with the Arduino core.
 *
 * 1. In mien's configuration: [serial] port = "/dev/serial/by-id/...", style = "cobs" (or "text"), baud = 115200.
 * 2. Choose the unit below. Its place is that in the line "$AUH,..." of the style "text", or in `mien print-config`.
 * 3. Upload, and close the serial monitor: the port is mien's.
 */
#include "mien.h"

/* 0: style "cobs"; 1: style "text" with serial.full = MIEN_FULL. */
#ifndef MIEN_TEXT
#define MIEN_TEXT 0
#endif
#ifndef MIEN_FULL
#define MIEN_FULL 100
#endif
/* Which weight drives the pin. */
#ifndef MIEN_UNIT
#define MIEN_UNIT 0
#endif
/* 1: each frame's number, state and value are printed, and the count of rejected frames. */
#ifndef MIEN_PRINT
#define MIEN_PRINT 0
#endif

const int PIN = 9;  /* one that can do PWM */

#if MIEN_TEXT
mien::TextReader face(MIEN_FULL);
#else
mien::CobsReader face;
#endif

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
}
