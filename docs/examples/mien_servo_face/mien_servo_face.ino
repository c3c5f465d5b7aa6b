/* A face of hobby servos: jaw, both corners of the mouth, both brows, lids. Uno, Nano, Mega or anything with the Servo library.
 *
 * 1. In mien's configuration:
 *      [serial]
 *      port = "/dev/serial/by-id/..."
 *      units = ["AU26", "AU12L", "AU12R", "AU1L", "AU1R", "AU43L"]
 *    The order of `units` is the order of the joints below.
 * 2. Power the servos from their own 5 V supply, grounds joined; set each joint's rest and full angle before linkages go on.
 * 3. Upload, and close the serial monitor: the port is mien's.
 */
#include <Servo.h>

#include "mien.h"

/* Pin, angle at rest, angle at full weight (degrees); full below rest turns the other way. */
struct Joint {
  uint8_t pin, rest, full;
};
const Joint JOINTS[] = {
  {3, 90, 130},  /* jaw: AU26 */
  {5, 90, 60},   /* corner of the mouth, left: AU12L */
  {6, 90, 120},  /* right: AU12R */
  {9, 90, 65},   /* brow, left: AU1L */
  {10, 90, 115}, /* right: AU1R */
  {11, 90, 20},  /* lids: AU43L */
};
const uint8_t COUNT = sizeof(JOINTS) / sizeof(JOINTS[0]);
/* With nothing heard for so long the face goes to rest. */
const unsigned long SILENCE_MS = 1000;

mien::Reader face;
Servo servos[COUNT];
unsigned long heard = 0;

void show(uint8_t joint, uint8_t weight) {
  const Joint& j = JOINTS[joint];
  servos[joint].write(j.rest + ((int)j.full - j.rest) * (int32_t)weight / 255);
}

void setup() {
  Serial.begin(115200);
  for (uint8_t k = 0; k < COUNT; k++) {
    servos[k].attach(JOINTS[k].pin);
    show(k, 0);
  }
}

void loop() {
  while (Serial.available()) {
    if (!face.feed(Serial.read())) continue;
    heard = millis();
    for (uint8_t k = 0; k < COUNT; k++) {
      bool known = face.state != mien::ABSENT && k < face.count;
      show(k, known ? face.weights[k] : 0);
    }
  }
  if (millis() - heard > SILENCE_MS) {
    for (uint8_t k = 0; k < COUNT; k++) show(k, 0);
  }
}
