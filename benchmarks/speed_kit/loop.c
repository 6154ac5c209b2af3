// SPDX-License-Identifier: Apache-2.0
/* The paper's example as one would write it by hand in C: plant (19) behind the dead-zone (1), law
   (8)-(17), four RK4 steps a sample, everything recorded. Same order of operations, so the same
   bits. cc -O2 -ffp-contract=off -shared -fPIC loop.c -lm */
#include <math.h>

typedef struct {
    double period, kd, k, epsilon, gamma, eta, lambda;
    double theta1, theta2, phi;            /* initial estimates */
    double a1, a2, a3, b, mr, ml, br, bl;  /* plant and dead-zone */
    double amplitude, frequency, x0, x1;
    long last, substeps;
} Example;

static double dead_zone(const Example *e, double v)
{
    if (v >= e->br)
        return e->mr * (v - e->br);
    if (v <= e->bl)
        return e->ml * (v - e->bl);
    return 0.0;
}

static void regressors(const double *x, double *y)
{
    y[0] = -tanh(0.5 * x[0]);
    y[1] = (x[0] * x[0] + 2.0 * x[0]) * sin(x[0]);
}

static double acceleration(const Example *e, const double *x, double v, double t)
{
    double y[2];
    regressors(x, y);
    double total = e->b * dead_zone(e, v) - 0.5 * e->a3 * x[0] * sin(3.0 * t);
    total -= e->a1 * y[0];
    total -= e->a2 * y[1];
    return total;
}

static void advance(const Example *e, double *x, double v, double t)
{
    double h = e->period / e->substeps;
    for (long step = 0; step < e->substeps; step++) {
        double now = t + step * h, stage[2], k1[2], k2[2], k3[2], k4[2];
        k1[0] = x[1];
        k1[1] = acceleration(e, x, v, now);
        for (int i = 0; i < 2; i++)
            stage[i] = x[i] + 0.5 * h * k1[i];
        k2[0] = stage[1];
        k2[1] = acceleration(e, stage, v, now + 0.5 * h);
        for (int i = 0; i < 2; i++)
            stage[i] = x[i] + 0.5 * h * k2[i];
        k3[0] = stage[1];
        k3[1] = acceleration(e, stage, v, now + 0.5 * h);
        for (int i = 0; i < 2; i++)
            stage[i] = x[i] + h * k3[i];
        k4[0] = stage[1];
        k4[1] = acceleration(e, stage, v, now + h);
        for (int i = 0; i < 2; i++)
            x[i] += h / 6.0 * (k1[i] + 2.0 * k2[i] + 2.0 * k3[i] + k4[i]);
    }
}

/* Rows of a sample: x (2), x_d (3), v, w, d, disturbance, terms (8), status, estimates (3). */
void run(const Example *e, double *out_x, double *out_x_d, double *out_v, double *out_truth,
         double *out_terms)
{
    double x[2] = {e->x0, e->x1};
    double theta1 = e->theta1, theta2 = e->theta2, phi = e->phi;
    double lambda = e->lambda;
    for (long k = 0; k <= e->last; k++) {
        double t = k * e->period, y[2];
        double sine = sin(e->frequency * t), cosine = cos(e->frequency * t);
        double xd = e->amplitude * sine;
        double dxd = e->amplitude * e->frequency * cosine;
        double ddxd = -(e->amplitude * e->frequency * e->frequency) * sine;
        regressors(x, y);
        double s = lambda * (x[0] - xd) + (x[1] - dxd);
        double u_fd = ddxd - lambda * (x[1] - dxd);
        double z = s / e->epsilon;
        double sat = z > 1.0 ? 1.0 : z < -1.0 ? -1.0 : z;
        double s_eps = s - e->epsilon * sat;
        double v_damping = -e->kd * s;
        double v_feed_forward = phi * u_fd;
        double v_regressor = y[0] * theta1 + y[1] * theta2;
        double v_robust = -e->k * sat;
        double v = v_damping + v_feed_forward + v_regressor + v_robust;
        double w = dead_zone(e, v);
        double *terms = out_terms + 12 * k;
        out_x[2 * k] = x[0];
        out_x[2 * k + 1] = x[1];
        out_x_d[3 * k] = xd;
        out_x_d[3 * k + 1] = dxd;
        out_x_d[3 * k + 2] = ddxd;
        out_v[k] = v;
        out_truth[3 * k] = w;
        out_truth[3 * k + 1] = w - (v >= 0.0 ? e->mr : e->ml) * v;
        out_truth[3 * k + 2] = 0.5 * e->a3 * x[0] * sin(3.0 * t);
        terms[0] = s;
        terms[1] = s_eps;
        terms[2] = u_fd;
        terms[3] = v_damping;
        terms[4] = v_feed_forward;
        terms[5] = v_regressor;
        terms[6] = v_robust;
        terms[7] = 0.0;
        terms[8] = 0.0;
        terms[9] = theta1;
        terms[10] = theta2;
        terms[11] = phi;
        theta1 -= e->period * e->gamma * y[0] * s_eps;
        theta2 -= e->period * e->gamma * y[1] * s_eps;
        phi -= e->period * e->eta * u_fd * s_eps;
        if (k < e->last)
            advance(e, x, v, t);
    }
}
