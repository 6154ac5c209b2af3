// SPDX-License-Identifier: Apache-2.0
/* The firmware on a PC: the line is standard input and output, the hardware DZ_MOTORS simulated
 * servos.
 *
 *     cc -std=c99 -O2 -Wall -Wextra -Werror -o firmware dz_device.c line_main.c -lm
 *     dz driver emulate serial --option program=./firmware
 *
 * Each servo is that of config/serial.yaml without its cogging: J q'' + B q' + T_c tanh(q'/w_s) =
 * K_t D(v), behind the dead-zone D of slope 1 between b_l and b_r; -DDZ_BANDS='{0.5, -0.6},
 * {0.3, -0.4}' gives the motors others, in turn. SIGUSR1 makes their amplifiers
 * report fault 7, SIGRTMIN + k that of motor k, SIGUSR2 takes it back. It ends with its line.
 */
#define _POSIX_C_SOURCE 200809L

#include "dz_device.h"

#include <math.h>
#include <poll.h>
#include <signal.h>
#include <stdlib.h>
#include <string.h>
#include <time.h>
#include <unistd.h>

#define COMMAND_SCALE 1e-3                  /* A in a count */
#define ANGLE_SCALE 1e-6                    /* rad */
#define SPEED_SCALE 1e-5                    /* rad/s */
#define STEP 1e-4                           /* of the integration [s] */

#ifndef DZ_BANDS
#define DZ_BANDS {0.5, -0.6}
#endif
static const double bands[][2] = {DZ_BANDS};    /* b_r, b_l of the motors, in turn [A] */

static volatile sig_atomic_t overcurrent[DZ_MOTORS];

struct servo {
    double t, angle, speed, current;
    const double *band;
};

struct bench {
    struct servo servos[DZ_MOTORS];
    int ended;
};

static void set_fault(int number)
{
    for (int motor = 0; motor < DZ_MOTORS; motor++)
        if (number == SIGUSR2)
            overcurrent[motor] = 0;
        else if (number == SIGUSR1 || number == SIGRTMIN + motor)
            overcurrent[motor] = 7;
}

static double seconds(void)
{
    struct timespec now;
    clock_gettime(CLOCK_MONOTONIC, &now);
    return (double)now.tv_sec + 1e-9 * (double)now.tv_nsec;
}

static double acceleration(const double *band, double speed, double current)
{
    const double b_r = band[0], b_l = band[1];
    double w = current >= b_r ? current - b_r : current <= b_l ? current - b_l : 0.0;
    return w - 0.4 * speed - 1.0 * tanh(speed / 0.01);
}

/* Move the servo to now: Heun's method in short steps. */
static void advance(struct servo *servo, double now)
{
    while (servo->t < now) {
        double h = now - servo->t < STEP ? now - servo->t : STEP;
        double a = acceleration(servo->band, servo->speed, servo->current);
        double b = acceleration(servo->band, servo->speed + h * a, servo->current);
        servo->angle += h * (servo->speed + 0.5 * h * a);
        servo->speed += 0.5 * h * (a + b);
        servo->t += h;
    }
}

static size_t line_read(void *self, uint8_t *data, size_t size)
{
    struct bench *bench = self;
    struct pollfd in = {.fd = STDIN_FILENO, .events = POLLIN};
    if (poll(&in, 1, 0) <= 0)
        return 0;
    ssize_t got = read(STDIN_FILENO, data, size);
    if (got == 0)
        bench->ended = 1;
    return got > 0 ? (size_t)got : 0;
}

static void line_write(void *self, const uint8_t *data, size_t size)
{
    struct bench *bench = self;
    struct pollfd out = {.fd = STDOUT_FILENO, .events = POLLOUT};
    if (poll(&out, 1, 0) > 0 && write(STDOUT_FILENO, data, size) < 0)
        bench->ended = 1;
}

static uint16_t servo_measure(void *self, uint8_t motor, int32_t *values)
{
    struct servo *servo = &((struct bench *)self)->servos[motor];
    advance(servo, seconds());
    values[0] = (int32_t)lround(servo->angle / ANGLE_SCALE);
    values[1] = (int32_t)lround(servo->speed / SPEED_SCALE);
    return (uint16_t)overcurrent[motor];
}

static void servo_actuate(void *self, uint8_t motor, int powered, int32_t v)
{
    struct servo *servo = &((struct bench *)self)->servos[motor];
    advance(servo, seconds());
    servo->current = powered ? COMMAND_SCALE * v : 0.0;
}

int main(void)
{
    struct dz_description description = {.values = 2, .name = "firmware on a PC"};
    struct bench bench = {.ended = 0};
    struct dz_hardware hardware = {line_read, line_write, servo_measure, servo_actuate, &bench};
    struct dz_device device;
    struct sigaction action;
    for (size_t motor = 0; motor < DZ_MOTORS; motor++) {
        bench.servos[motor] = (struct servo){
            .t = seconds(), .angle = 0.1, .band = bands[motor % (sizeof bands / sizeof *bands)]};
        description.motors[motor] = (struct dz_motor){
            .limit = 30000, .command_scale = (float)COMMAND_SCALE,
            .state_scales = {(float)ANGLE_SCALE, (float)SPEED_SCALE}};
    }
    memset(&action, 0, sizeof action);
    action.sa_handler = set_fault;
    sigaction(SIGUSR1, &action, NULL);
    sigaction(SIGUSR2, &action, NULL);
    for (int motor = 0; motor < DZ_MOTORS; motor++)
        sigaction(SIGRTMIN + motor, &action, NULL);
    signal(SIGPIPE, SIG_IGN);
    dz_device_init(&device, &hardware, &description);
    while (!bench.ended) {
        struct pollfd in = {.fd = STDIN_FILENO, .events = POLLIN};
        struct timespec nap = {0, 100000};
        dz_device_step(&device, (uint32_t)(uint64_t)(seconds() * 1e6));
        if (poll(&in, 1, 0) == 0)
            nanosleep(&nap, NULL);
    }
    return EXIT_SUCCESS;
}
