/* Reads what mien writes to a serial port: style "text" (lines with a checksum) or "cobs" (binary frames with CRC), whichever
 * comes. Plain C++, no library: any board, any compiler. Call Reader::feed() with every byte; it returns true when a whole frame
 * that checks has come in, which then stands in the fields. It may start listening in the middle of a stream, and what was
 * damaged on the line is dropped and counted. Memory: about 400 bytes; half of it with TextReader or CobsReader alone.
 */
#pragma once
#include <stdint.h>
#include <string.h>

namespace mien {

enum State : uint8_t { ABSENT, WARMING, TRACKING, HELD, LOST, POSED };

/** Most units a frame can have: what fits the 64 bytes that an AVR's serial port keeps. */
const uint8_t MOST_UNITS = 52;

/** What a frame says. */
struct Frame {
  uint16_t number;               /* counts frames; 8 bits of it with cobs */
  uint32_t time_ms;              /* capture time; 16 bits of it with cobs */
  uint8_t state;                 /* State */
  uint8_t confidence;            /* 0..255 */
  uint8_t count;                 /* of weights */
  uint8_t weights[MOST_UNITS];   /* 0..255, in the order of the names that mien logs and sends */
  uint16_t rejected;             /* frames so far that did not check */
};

/** CRC-16/MCRF4XX, one byte further; avr-libc calls it _crc_ccitt_update. */
inline uint16_t crc_step(uint16_t crc, uint8_t byte) {
  byte ^= (uint8_t)crc;
  byte ^= (uint8_t)(byte << 4);
  return (uint16_t)(((uint16_t)byte << 8 | crc >> 8) ^ (uint8_t)(byte >> 4) ^ (uint16_t)byte << 3);
}

/** Style "cobs". */
class CobsReader : public Frame {
 public:
  CobsReader() : Frame(), length_(0), left_(0), code_(0), bad_(true) {}

  bool feed(uint8_t byte) {
    if (byte == 0) return end();
    if (left_ == 0) {
      /* A code byte: so many bytes follow that are not 0; before it stood a 0, unless the run was the longest. */
      if (code_ != 0 && code_ != 0xFF) put(0);
      code_ = byte;
      left_ = byte - 1;
    } else {
      left_--;
      put(byte);
    }
    return false;
  }

 private:
  void put(uint8_t byte) {
    if (length_ < sizeof(payload_)) payload_[length_++] = byte;
    else bad_ = true;
  }

  bool end() {
    bool first = code_ == 0 && length_ == 0;
    bool whole = !bad_ && left_ == 0 && length_ >= 4;
    if (whole) {
      uint16_t crc = 0xFFFF;
      for (uint8_t i = 0; i < length_ - 2; i++) crc = crc_step(crc, payload_[i]);
      whole = payload_[length_ - 2] == (uint8_t)crc && payload_[length_ - 1] == (uint8_t)(crc >> 8);
    }
    /* The first end ends what began before anybody listened. */
    if (!whole && !first && joined_) rejected++;
    joined_ = true;
    bool weights = whole && payload_[0] == 1 && length_ >= 9 && payload_[6] <= MOST_UNITS && length_ == payload_[6] + 9;
    if (weights) {
      uint8_t flags = payload_[4];
      number = payload_[1];
      time_ms = payload_[2] | (uint16_t)payload_[3] << 8;
      state = flags & 1 ? TRACKING : flags & 4 ? WARMING : flags & 64 ? POSED : flags & 8 ? HELD : ABSENT;
      confidence = payload_[5];
      count = payload_[6];
      memcpy(Frame::weights, payload_ + 7, count);
    }
    length_ = left_ = code_ = 0;
    bad_ = false;
    return weights;
  }

  uint8_t payload_[64];
  uint8_t length_, left_, code_;
  bool bad_, joined_ = false;
};

/** Style "text". `full` is what the configuration calls serial.full. */
class TextReader : public Frame {
 public:
  explicit TextReader(uint16_t full = 100) : Frame(), full_(full), at_(OUTSIDE) {}

  bool feed(uint8_t byte) {
    if (byte == '$') {
      if (at_ != OUTSIDE) rejected++;
      at_ = NAME;
      sum_ = field_ = name_ = digits_ = 0;
      value_ = 0;
      next_ = Frame();
      return false;
    }
    switch (at_) {
      case OUTSIDE: return false;
      case NAME:
        sum_ ^= byte;
        if (byte == ',') at_ = name_ == 2 ? FIELDS : OTHER;
        else if (name_ < 3 && byte == "AU"[name_ & 1] && name_ < 2) name_++;
        else name_ = 3;
        return false;
      case FIELDS:
        if (byte == ',' || byte == '*') {
          if (!take()) return refuse();
          if (byte == ',') sum_ ^= byte;
          else at_ = HIGH_DIGIT;
        } else if (byte >= '0' && byte <= '9' && digits_ < 2) {
          sum_ ^= byte;
          value_ = value_ * 10 + (byte - '0');
          if (digits_) digits_ = 2;
        } else if (byte == '.' && field_ > 3 && !digits_) { /* weights may have tenths */
          sum_ ^= byte;
          digits_ = 1;
        } else {
          return refuse();
        }
        return false;
      case OTHER: /* a header or a pose: only its checksum matters */
        if (byte == '*') at_ = OTHER_HIGH;
        else if (byte == '\n') return refuse();
        else sum_ ^= byte;
        return false;
      case HIGH_DIGIT:
      case OTHER_HIGH:
        if (byte != digit(sum_ >> 4)) return refuse();
        at_ = at_ == HIGH_DIGIT ? LOW_DIGIT : OTHER_LOW;
        return false;
      case LOW_DIGIT:
      case OTHER_LOW: {
        bool frame = at_ == LOW_DIGIT;
        if (byte != digit(sum_ & 15)) return refuse();
        at_ = OUTSIDE;
        if (!frame || field_ < 4) return false;
        uint16_t before = rejected;
        static_cast<Frame&>(*this) = next_;
        rejected = before;
        return true;
      }
    }
    return false;
  }

 private:
  enum At : uint8_t { OUTSIDE, NAME, FIELDS, OTHER, HIGH_DIGIT, LOW_DIGIT, OTHER_HIGH, OTHER_LOW };

  static uint8_t digit(uint8_t nibble) { return nibble < 10 ? '0' + nibble : 'A' + nibble - 10; }

  bool refuse() {
    rejected++;
    at_ = OUTSIDE;
    return false;
  }

  /* Takes the number that has just ended. */
  bool take() {
    switch (field_) {
      case 0: next_.number = value_; break;
      case 1: next_.time_ms = value_; break;
      case 2: next_.state = value_; break;
      case 3: next_.confidence = (value_ * 255 + 49) / 99; break;
      default:
        if (digits_ < 2) value_ *= 10;
        if (next_.count == MOST_UNITS || digits_ == 1 || value_ > 10UL * full_) return false;
        next_.weights[next_.count++] = (value_ * 255 + 5UL * full_) / (10UL * full_);
    }
    field_++;
    digits_ = 0;
    value_ = 0;
    return true;
  }

  Frame next_;
  uint32_t value_;
  uint16_t full_;
  uint8_t sum_, field_, name_;
  uint8_t digits_; /* 1 behind a point, 2 behind its digit */
  At at_;
};

/** Either style. `full` is what the configuration calls serial.full. */
class Reader : public Frame {
 public:
  explicit Reader(uint16_t full = 100) : Frame(), text_(full) {}

  bool feed(uint8_t byte) {
    bool text = text_.feed(byte), cobs = cobs_.feed(byte);
    if (text) static_cast<Frame&>(*this) = text_;
    if (cobs) static_cast<Frame&>(*this) = cobs_;
    return text || cobs;
  }

 private:
  TextReader text_;
  CobsReader cobs_;
};

}  // namespace mien
