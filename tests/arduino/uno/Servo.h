/* As much of the Servo library as the sketch uses: what a servo is told anew is printed, pin and angle. */
#pragma once
#include "Arduino.h"

class Servo {
 public:
  void attach(int pin) { pin_ = pin; }

  void write(int angle) {
    if (angle == angle_) return;
    angle_ = angle;
    Serial.print(pin_);
    Serial.print(' ');
    Serial.println((uint16_t)angle);
  }

 private:
  int pin_ = 0, angle_ = -1;
};
