// The sketch's readers on this machine, under its sanitizers: whatever comes in, they stay within their memory, give no frame
// that is longer than it can be, and take the second good frame after it.
#include <stdio.h>
#include <stdlib.h>

#include "mien.h"

// type 1, number 1, 33 ms, tracked, confidence 200, weights 0 128 255
static const uint8_t COBS[] = {4, 1, 1, 0x21, 4, 1, 0xc8, 3, 5, 0x80, 0xff, 0x17, 0x79, 0};
static const char TEXT[] = "$AU,1,33,2,78,0,50,100*30\r\n";

static uint32_t seed = 1;
static uint32_t dice(uint32_t below) {
  seed = seed * 1664525 + 1013904223;
  return (seed >> 8) % below;
}

template <class Reader>
static void fuzz(Reader reader, const uint8_t* good, size_t length, const char* signs) {
  unsigned taken = 0, rounds = 300000;
  for (unsigned round = 0; round < rounds; round++) {
    for (uint32_t n = dice(200); n > 0; n--) {
      uint8_t byte = dice(2) ? dice(256) : dice(3) ? signs[dice(12)] : good[dice(length)];
      if (reader.feed(byte) && reader.count > mien::MOST_UNITS) abort();
    }
    for (unsigned again = 0; again < 2; again++)
      for (size_t i = 0; i < length; i++) {
        bool whole = reader.feed(good[i]);
        if (again == 0) continue;
        if (!whole) continue;
        taken++;
        if (reader.count != 3 || reader.weights[0] != 0 || reader.weights[1] != 128 || reader.weights[2] != 255) abort();
      }
  }
  if (taken != rounds) {
    printf("%u of %u good frames taken\n", taken, rounds);
    exit(1);
  }
}

int main() {
  fuzz(mien::CobsReader(), COBS, sizeof COBS, "\0\0\1\2\377\377\100\101\77\5\4\3");
  fuzz(mien::TextReader(), (const uint8_t*)TEXT, sizeof TEXT - 1, "$AU,**0912\r\n");
  fuzz(mien::Reader(), COBS, sizeof COBS, "\0\0\1\2\377\377\100\101\77\5\4\3");
  fuzz(mien::Reader(), (const uint8_t*)TEXT, sizeof TEXT - 1, "$AU,**0912\r\n");
  printf("readers: 1200000 rounds of noise, the second good frame taken in each\n");
}
