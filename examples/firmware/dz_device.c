// SPDX-License-Identifier: Apache-2.0
/* See dz_device.h. */
#include "dz_device.h"

#include <string.h>

enum { HELLO = 0x01, COMMAND = 0x02, INFO = 0x81, STATE = 0x82 };
/* Lengths of bodies, and where what is of one motor begins in them: the rows. */
#if DZ_MOTORS == 1
enum { HELLO_SIZE = 10, COMMAND_SIZE = 21, INFO_SIZE = 47 };
enum { HOLD_AT = 18, COMMAND_ROWS = 10, INFO_ROWS = 7, NAME_AT = 31, STATE_ROWS = 20 };
#else
enum { HELLO_SIZE = 11, COMMAND_SIZE = 14 + 8 * DZ_MOTORS, INFO_SIZE = 24 + 24 * DZ_MOTORS };
enum { HOLD_AT = 10, COMMAND_ROWS = 14, INFO_ROWS = 24, NAME_AT = 8, STATE_ROWS = 22 };
#endif
enum { MAX_STATE_SIZE = STATE_ROWS + DZ_MOTORS * (2 + 4 * DZ_MAX_VALUES) };

/* Whatever travels fits. */
typedef char dz_bodies_fit[INFO_SIZE <= DZ_MAX_BODY && MAX_STATE_SIZE <= DZ_MAX_BODY
                           && COMMAND_SIZE <= DZ_MAX_BODY ? 1 : -1];

/* A float must be IEEE 754 single precision: four bytes at least. */
typedef char dz_float_has_four_bytes[sizeof(float) == 4 ? 1 : -1];

static void put16(uint8_t *at, uint16_t value)
{
    at[0] = (uint8_t)(value & 0xFFu);
    at[1] = (uint8_t)(value >> 8);
}

static void put32(uint8_t *at, uint32_t value)
{
    put16(at, (uint16_t)(value & 0xFFFFu));
    put16(at + 2, (uint16_t)(value >> 16));
}

static void put_float(uint8_t *at, float value)
{
    uint32_t bits;
    memcpy(&bits, &value, 4);
    put32(at, bits);
}

static uint16_t get16(const uint8_t *at)
{
    return (uint16_t)(at[0] | ((uint16_t)at[1] << 8));
}

static uint32_t get32(const uint8_t *at)
{
    return (uint32_t)get16(at) | ((uint32_t)get16(at + 2) << 16);
}

static int32_t get_signed(const uint8_t *at)
{
    uint32_t bits = get32(at);      /* a cast of what does not fit is not portable */
    return bits <= INT32_MAX ? (int32_t)bits : -(int32_t)(UINT32_MAX - bits) - 1;
}

/* CRC-32 of IEEE 802.3, reflected polynomial, a table of sixteen in place of 1 kB. */
uint32_t dz_crc32(const uint8_t *data, size_t size)
{
    static const uint32_t table[16] = {
        0x00000000u, 0x1DB71064u, 0x3B6E20C8u, 0x26D930ACu, 0x76DC4190u, 0x6B6B51F4u,
        0x4DB26158u, 0x5005713Cu, 0xEDB88320u, 0xF00F9344u, 0xD6D6A3E8u, 0xCB61B38Cu,
        0x9B64C2B0u, 0x86D3D2D4u, 0xA00AE278u, 0xBDBDF21Cu};
    uint32_t crc = 0xFFFFFFFFu;
    for (size_t i = 0; i < size; i++) {
        crc ^= data[i];
        crc = (crc >> 4) ^ table[crc & 15u];
        crc = (crc >> 4) ^ table[crc & 15u];
    }
    return crc ^ 0xFFFFFFFFu;
}

size_t dz_cobs_encode(const uint8_t *data, size_t size, uint8_t *line)
{
    size_t code_at = 0, at = 1;
    uint8_t code = 1;
    for (size_t i = 0; i < size; i++) {
        if (data[i] != 0) {
            line[at++] = data[i];
            code++;
        }
        if (data[i] == 0 || (code == 0xFF && i + 1 < size)) {
            line[code_at] = code;
            code_at = at++;
            code = 1;
        }
    }
    line[code_at] = code;
    return at;
}

size_t dz_cobs_decode(const uint8_t *line, size_t size, uint8_t *data)
{
    size_t at = 0, made = 0;
    if (size == 0)
        return SIZE_MAX;
    while (at < size) {
        uint8_t code = line[at++];
        if (code == 0 || (size_t)(code - 1) > size - at)
            return SIZE_MAX;
        for (uint8_t i = 1; i < code; i++) {
            if (line[at] == 0)
                return SIZE_MAX;
            data[made++] = line[at++];
        }
        if (code < 0xFF && at < size)
            data[made++] = 0;
    }
    return made;
}

/* Send a body of `size` bytes; there must be room for the CRC behind it. */
static void send(struct dz_device *device, uint8_t *body, size_t size)
{
    uint8_t line[DZ_MAX_LINE + 1];
    put32(body + size, dz_crc32(body, size));
    size_t length = dz_cobs_encode(body, size + 4, line);
    line[length++] = 0;
    device->hardware->write(device->hardware->self, line, length);
}

static int32_t clip(const struct dz_device *device, size_t motor, int32_t v)
{
    int32_t limit = device->description->motors[motor].limit;
    return v > limit ? limit : v < -limit ? -limit : v;
}

/* Take a mode and give each motor what belongs to it; v is only used in RUN. */
static void enter(struct dz_device *device, enum dz_mode mode, const int32_t *v)
{
    const struct dz_hardware *hardware = device->hardware;
    device->mode = mode;
    for (uint8_t motor = 0; motor < DZ_MOTORS; motor++)
        hardware->actuate(hardware->self, motor, mode == DZ_RUN || mode == DZ_SAFE,
                          mode == DZ_RUN ? v[motor] : mode == DZ_SAFE ? device->safe[motor] : 0);
}

/* Begin a session without power; the same HELLO again changes nothing but the period. */
static void greet(struct dz_device *device, const uint8_t *body, uint32_t now_us)
{
    const struct dz_description *is = device->description;
    uint32_t session = get32(body + 2), period_us = get32(body + 6);
    uint8_t info[INFO_SIZE + 4];
    if (session == 0 || period_us == 0)
        return;
    if (session != device->session) {
        device->session = session;
        device->fresh = 1;
        device->echo = 0;
        if (device->mode == DZ_RUN || device->mode == DZ_SAFE)
            enter(device, DZ_DISABLED, NULL);
    }
    device->period_us = period_us < DZ_MIN_PERIOD_US ? DZ_MIN_PERIOD_US
        : period_us > DZ_MAX_PERIOD_US ? DZ_MAX_PERIOD_US : period_us;
    device->due_us = now_us;
    info[0] = DZ_VERSION;
    info[1] = INFO;
    put32(info + 2, session);
#if DZ_MOTORS == 1
    info[6] = is->values;
#else
    info[6] = DZ_MOTORS;
    info[7] = is->values;
#endif
    for (size_t motor = 0; motor < DZ_MOTORS; motor++) {
        const struct dz_motor *own = &is->motors[motor];
        uint8_t *row = info + INFO_ROWS + 24 * motor;
        put32(row, (uint32_t)own->limit);
        put_float(row + 4, own->command_scale);
        for (size_t i = 0; i < DZ_MAX_VALUES; i++)
            put_float(row + 8 + 4 * i, i < is->values ? own->state_scales[i] : 0.0f);
    }
    memcpy(info + NAME_AT, is->name, 16);
    send(device, info, INFO_SIZE);
}

/* Do what a command asks, if it is of this session and newer than the newest. */
static void take(struct dz_device *device, const uint8_t *body, uint32_t now_us)
{
    uint32_t session = get32(body + 2), seq = get32(body + 6), ahead = seq - device->echo;
    uint16_t hold_ms = get16(body + HOLD_AT);
    uint8_t request = body[HOLD_AT + 2];
    int32_t v[DZ_MOTORS];
    if (hold_ms == 0 || hold_ms > DZ_MAX_HOLD_MS || request > DZ_ASK_RESET)
        return;
    if (device->session == 0 || session != device->session)
        return;
    if (!device->fresh && (ahead == 0 || ahead >= 0x80000000u))
        return;
    device->fresh = 0;
    device->echo = seq;
    device->taken_us = now_us;
    device->hold_us = 1000u * (uint32_t)hold_ms;
    device->expired = 0;
    for (size_t motor = 0; motor < DZ_MOTORS; motor++) {
        const uint8_t *row = body + COMMAND_ROWS + 8 * motor;
        v[motor] = clip(device, motor, get_signed(row));
        device->safe[motor] = clip(device, motor, get_signed(row + 4));
    }
    if (request == DZ_ASK_ESTOP) {
        enter(device, DZ_ESTOP, NULL);
    } else if (device->mode == DZ_FAULT || device->mode == DZ_ESTOP) {
        if (request == DZ_ASK_RESET) {
            memset(device->faults, 0, sizeof device->faults);
            enter(device, DZ_DISABLED, NULL);   /* a lasting fault is back before the next state */
        }
    } else if (request == DZ_ASK_RUN && device->mode != DZ_DISABLED) {
        enter(device, DZ_RUN, v);
    } else if (request == DZ_ASK_SAFE) {
        enter(device, DZ_SAFE, NULL);
    } else if (request == DZ_ASK_DISABLE) {
        enter(device, DZ_DISABLED, NULL);
    }
}

/* Look at a line that has ended. */
static void judge(struct dz_device *device, uint32_t now_us)
{
    uint8_t *body = device->line;
    size_t size = dz_cobs_decode(device->line, device->length, body);
    if (size == SIZE_MAX || size < 6 || dz_crc32(body, size - 4) != get32(body + size - 4))
        return;
    size -= 4;
    if (body[0] != DZ_VERSION)
        return;
#if DZ_MOTORS > 1
    if ((body[1] == HELLO && size == HELLO_SIZE && body[10] != DZ_MOTORS)
        || (body[1] == COMMAND && size == COMMAND_SIZE && body[13] != DZ_MOTORS))
        return;
#endif
    if (body[1] == HELLO && size == HELLO_SIZE)
        greet(device, body, now_us);
    else if (body[1] == COMMAND && size == COMMAND_SIZE)
        take(device, body, now_us);
}

static void receive(struct dz_device *device, uint8_t byte, uint32_t now_us)
{
    if (byte == 0) {
        if (!device->skipping && device->length > 0)
            judge(device, now_us);
        device->length = 0;
        device->skipping = 0;
    } else if (device->length == DZ_MAX_LINE) {
        device->skipping = 1;
    } else {
        device->line[device->length++] = byte;
    }
}

void dz_device_init(struct dz_device *device, const struct dz_hardware *hardware,
                    const struct dz_description *description)
{
    memset(device, 0, sizeof *device);
    device->hardware = hardware;
    device->description = description;
    device->period_us = DZ_IDLE_PERIOD_US;
    enter(device, DZ_DISABLED, NULL);
}

void dz_device_step(struct dz_device *device, uint32_t now_us)
{
    const struct dz_hardware *hardware = device->hardware;
    uint8_t bytes[32], state[MAX_STATE_SIZE + 4];
    int32_t values[DZ_MOTORS][DZ_MAX_VALUES] = {{0}};
    uint8_t faulty = 0;
    size_t got, size = STATE_ROWS;
    /* A flood of bytes must not keep the watchdog from its turn. */
    for (int turn = 0; turn < 8; turn++) {
        got = hardware->read(hardware->self, bytes, sizeof bytes);
        for (size_t i = 0; i < got; i++)
            receive(device, bytes[i], now_us);
        if (got < sizeof bytes)
            break;
    }
    /* Once it has expired it stays so, or the clock's wrapping around would revive it. */
    if (!device->expired && now_us - device->taken_us >= device->hold_us)
        device->expired = 1;
    if (device->expired && (device->mode == DZ_RUN || device->mode == DZ_SAFE)) {
        if (device->mode == DZ_RUN)
            device->trips++;
        enter(device, DZ_SAFE, NULL);
    }
    for (uint8_t motor = 0; motor < DZ_MOTORS; motor++) {
        uint16_t fault = hardware->measure(hardware->self, motor, values[motor]);
        if (fault != 0 && device->mode != DZ_ESTOP) {
            device->faults[motor] = fault;
            faulty = 1;
        }
    }
    if (faulty)
        enter(device, DZ_FAULT, NULL);
    if (now_us - device->due_us >= 0x80000000u && device->seq != 0)
        return;
    device->due_us += device->period_us;
    if (device->seq == 0 || now_us - device->due_us < 0x80000000u)  /* the first, or late */
        device->due_us = now_us + device->period_us;
    state[0] = DZ_VERSION;
    state[1] = STATE;
    put32(state + 2, device->session);
    put32(state + 6, ++device->seq);
    put32(state + 10, now_us);
    put32(state + 14, device->echo);
    state[18] = (uint8_t)device->mode;
    state[19] = device->trips;
#if DZ_MOTORS > 1
    state[20] = DZ_MOTORS;
    state[21] = device->description->values;
#endif
    for (size_t motor = 0; motor < DZ_MOTORS; motor++) {
        put16(state + size, device->faults[motor]);
        size += 2;
        for (size_t i = 0; i < device->description->values && i < DZ_MAX_VALUES; i++, size += 4)
            put32(state + size, (uint32_t)values[motor][i]);
    }
    send(device, state, size);
}
