/* An emulated Arduino Uno behind standard input and output: what comes in goes to the serial port byte by byte at the
 * speed of the line, what the sketch prints comes out. The processor runs at 16 MHz by the wall clock, so that a sketch
 * that is too slow loses bytes as a real one does. Built on simavr. Ends when the input does.
 *
 * board FIRMWARE.elf BAUD
 */
#include <fcntl.h>
#include <simavr/avr_uart.h>
#include <simavr/sim_avr.h>
#include <simavr/sim_elf.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <time.h>
#include <unistd.h>

static void printed(struct avr_irq_t *irq, uint32_t byte, void *unused) {
  (void)irq, (void)unused;
  putchar(byte);
  if (byte == '\n') fflush(stdout);
}

/* simavr takes a byte in a little more time than the line gives it in, and says when it can take no more. */
static int room = 1;

static void has_room(struct avr_irq_t *irq, uint32_t value, void *unused) {
  (void)irq, (void)value, (void)unused;
  room = 1;
}

static void is_full(struct avr_irq_t *irq, uint32_t value, void *unused) {
  (void)irq, (void)value, (void)unused;
  room = 0;
}

static double now(void) {
  struct timespec t;
  clock_gettime(CLOCK_MONOTONIC, &t);
  return t.tv_sec + 1e-9 * t.tv_nsec;
}

int main(int argc, char **argv) {
  elf_firmware_t firmware;
  memset(&firmware, 0, sizeof firmware);
  if (argc != 3 || elf_read_firmware(argv[1], &firmware)) {
    fprintf(stderr, "usage: board FIRMWARE.elf BAUD\n");
    return 1;
  }
  avr_t *avr = avr_make_mcu_by_name("atmega328p");
  avr_init(avr);
  avr->frequency = 16000000;
  avr_load_firmware(avr, &firmware);
  uint32_t flags = 0;
  avr_ioctl(avr, AVR_IOCTL_UART_GET_FLAGS('0'), &flags);
  flags &= ~AVR_UART_FLAG_STDIO;
  avr_ioctl(avr, AVR_IOCTL_UART_SET_FLAGS('0'), &flags);
  avr_irq_t *in = avr_io_getirq(avr, AVR_IOCTL_UART_GETIRQ('0'), UART_IRQ_INPUT);
  avr_irq_register_notify(avr_io_getirq(avr, AVR_IOCTL_UART_GETIRQ('0'), UART_IRQ_OUTPUT), printed, NULL);
  avr_irq_register_notify(avr_io_getirq(avr, AVR_IOCTL_UART_GETIRQ('0'), UART_IRQ_OUT_XON), has_room, NULL);
  avr_irq_register_notify(avr_io_getirq(avr, AVR_IOCTL_UART_GETIRQ('0'), UART_IRQ_OUT_XOFF), is_full, NULL);
  fcntl(0, F_SETFL, fcntl(0, F_GETFL) | O_NONBLOCK);

  const avr_cycle_count_t byte_cycles = 10 * 16000000 / atoi(argv[2]);
  avr_cycle_count_t next = 0, ended = 0;
  double start = now();
  uint8_t waiting[4096];
  ssize_t have = 0, given = 0;
  for (;;) {
    int state = avr_run(avr);
    if (state == cpu_Done || state == cpu_Crashed) {
      fprintf(stderr, "the processor has stopped\n");
      return 1;
    }
    if (avr->cycle < next) continue;
    next = avr->cycle + byte_cycles;
    if (given == have && !ended) {
      given = 0;
      have = read(0, waiting, sizeof waiting);
      if (have == 0) ended = avr->cycle + 1600000; /* a tenth of a second to print what there is */
      if (have < 0) have = 0;
    }
    if (given < have && room) avr_raise_irq(in, waiting[given++]);
    if (ended && avr->cycle > ended) break;
    double ahead = avr->cycle / 16e6 - (now() - start);
    if (ahead > 1e-3) usleep(1e6 * ahead);
  }
  fflush(stdout);
  return 0;
}
