// SPDX-License-Identifier: Apache-2.0
/* The device's side of dz_ros' serial protocol, version 1, for a microcontroller.
 *
 * Portable C99: fixed-width integers, 8-bit bytes, no allocation, no clock, no global; any byte
 * order and alignment. docs/serial.md says what travels; dz_ros/drivers/serial/device.py is the
 * same machine in Python. Hardware is reached through the four functions of struct dz_hardware.
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

#define DZ_VERSION 1
#define DZ_MAX_VALUES 4
#define DZ_MAX_BODY 60                      /* longest body of a frame */
#define DZ_MAX_LINE (DZ_MAX_BODY + 4 + 1)   /* with CRC and COBS, without the zero that ends it */
#define DZ_MAX_HOLD_MS 1000
#define DZ_MIN_PERIOD_US 200
#define DZ_IDLE_PERIOD_US 100000u           /* of the states before the first greeting */

enum dz_mode { DZ_DISABLED, DZ_RUN, DZ_SAFE, DZ_FAULT, DZ_ESTOP };
enum dz_request { DZ_ASK_DISABLE, DZ_ASK_RUN, DZ_ASK_SAFE, DZ_ASK_ESTOP, DZ_ASK_RESET };

/* The hardware. None of the four may wait. */
struct dz_hardware {
    /* Copy up to `size` received bytes, return how many; 0 if none. */
    size_t (*read)(void *self, uint8_t *data, size_t size);
    /* Take bytes to send; what does not fit into the sender's buffer may be lost. */
    void (*write)(void *self, const uint8_t *data, size_t size);
    /* Write x, x', ... in counts; return a fault code, 0 = none. */
    uint16_t (*measure)(void *self, int32_t *values);
    /* Give the actuator a command in counts; powered = 0: no power, v is 0. */
    void (*actuate)(void *self, int powered, int32_t v);
    void *self;
};

/* What the device is; scales are units per count. */
struct dz_description {
    uint8_t values;                         /* how many of x, x', ... it measures, 1 to 4 */
    int32_t limit;                          /* largest |v| in counts */
    float command_scale;                    /* IEEE 754 single precision */
    float state_scales[DZ_MAX_VALUES];
    char name[16];                          /* padded with zeros */
};

struct dz_device {
    const struct dz_hardware *hardware;
    const struct dz_description *description;
    enum dz_mode mode;
    uint32_t session, seq, echo;
    uint32_t period_us, due_us;             /* of the states */
    uint32_t taken_us, hold_us;             /* of the newest command */
    int32_t safe;
    uint16_t fault;
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
