// SPDX-License-Identifier: Apache-2.0
/* The device's side of dz_ros' serial protocol for a microcontroller: version 1 with one motor,
 * version 2 with DZ_MOTORS = 2 to 8 of them, e.g. by -DDZ_MOTORS=3.
 *
 * Portable C99: fixed-width integers, 8-bit bytes, no allocation, no clock, no global; any byte
 * order and alignment. docs/serial.md says what travels; dz_ros/drivers/serial/device.py is the
 * same machine in Python. Hardware is reached through the four functions of struct dz_hardware.
 * All motors have one mode and one watchdog: a fault of one takes the power of all.
 *
 *     static struct dz_device device;
 *     dz_device_init(&device, &hardware, &description);
 *     for (;;) dz_device_step(&device, micros());     // at least ten times a state's period
 */
#ifndef DZ_DEVICE_H
#define DZ_DEVICE_H

#include <stddef.h>
#include <stdint.h>

#ifdef __cplusplus
extern "C" {
#endif

#ifndef DZ_MOTORS
#define DZ_MOTORS 1
#endif
#define DZ_MAX_MOTORS 8
#if DZ_MOTORS < 1 || DZ_MOTORS > DZ_MAX_MOTORS
#error "DZ_MOTORS must be 1 to 8"
#endif
#define DZ_VERSION (DZ_MOTORS == 1 ? 1 : 2)
#define DZ_MAX_VALUES 4
/* Longest body of a frame, that of INFO of several motors. */
#define DZ_MAX_BODY (DZ_MOTORS == 1 ? 60 : 24 + 24 * DZ_MOTORS)
#define DZ_MAX_LINE (DZ_MAX_BODY + 4 + 1)   /* with CRC and COBS, without the zero that ends it */
#define DZ_MAX_HOLD_MS 1000
#define DZ_MIN_PERIOD_US 200
#define DZ_MAX_PERIOD_US 0x7FFFFFFFu        /* half of what the clock counts */
#define DZ_IDLE_PERIOD_US 100000u           /* of the states before the first greeting */

enum dz_mode { DZ_DISABLED, DZ_RUN, DZ_SAFE, DZ_FAULT, DZ_ESTOP };
enum dz_request { DZ_ASK_DISABLE, DZ_ASK_RUN, DZ_ASK_SAFE, DZ_ASK_ESTOP, DZ_ASK_RESET };

/* The hardware. None of the four may wait. A motor is a number from 0 to DZ_MOTORS - 1. */
struct dz_hardware {
    /* Copy up to `size` received bytes, return how many; 0 if none. */
    size_t (*read)(void *self, uint8_t *data, size_t size);
    /* Take bytes to send; what does not fit into the sender's buffer may be lost. */
    void (*write)(void *self, const uint8_t *data, size_t size);
    /* Write x, x', ... of a motor in counts, `values` of them; return its fault code, 0 = none. */
    uint16_t (*measure)(void *self, uint8_t motor, int32_t *values);
    /* Give a motor a command in counts; powered = 0: no power, v is 0. */
    void (*actuate)(void *self, uint8_t motor, int powered, int32_t v);
    void *self;
};

/* What a motor is; scales are units per count. */
struct dz_motor {
    int32_t limit;                          /* largest |v| in counts, positive */
    float command_scale;                    /* IEEE 754 single precision */
    float state_scales[DZ_MAX_VALUES];
};

/* What the device is. */
struct dz_description {
    uint8_t values;                         /* of each motor x, x', ...: so many, 1 to 4 */
    struct dz_motor motors[DZ_MOTORS];
    char name[16];                          /* padded with zeros */
};

struct dz_device {
    const struct dz_hardware *hardware;
    const struct dz_description *description;
    enum dz_mode mode;
    uint32_t session, seq, echo;
    uint32_t period_us, due_us;             /* of the states */
    uint32_t taken_us, hold_us;             /* of the newest command */
    int32_t safe[DZ_MOTORS];
    uint16_t faults[DZ_MOTORS];
    uint8_t trips, fresh, expired, skipping;
    size_t length;
    uint8_t line[DZ_MAX_LINE];
};

void dz_device_init(struct dz_device *device, const struct dz_hardware *hardware,
                    const struct dz_description *description);

/* Take what has arrived, look at the clock [us, wraps around], send what is due. */
void dz_device_step(struct dz_device *device, uint32_t now_us);

/* The pieces, for tests. */
uint32_t dz_crc32(const uint8_t *data, size_t size);
size_t dz_cobs_encode(const uint8_t *data, size_t size, uint8_t *line);
/* Return the length of the data, or SIZE_MAX where the line is not COBS. In place is allowed. */
size_t dz_cobs_decode(const uint8_t *line, size_t size, uint8_t *data);

#ifdef __cplusplus
}
#endif

#endif
