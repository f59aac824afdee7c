/* The offsets of X, Y, Z from the nine thermal errors and from where the tool is, once per servo period. Plain C without
   LinuxCNC, so that it can be tested alone; talc_errors.comp gives it its pins. Lengths: mm; errors and offsets: µm, the
   angles µm/m; A in radians; seconds.

   The errors move slowly: talc_weights says how far one µm (µm/m) of each moves a point of the travel at most, and the
   slew holds for the sum. Where the tool is counts at once. What would be a step for another reason (a tool change, the
   end of homing or of probing, another bound) goes into `bridge`, which is taken back at half of the slew: the errors
   have the other half. */

#ifndef TALC_ERRORS_H
#define TALC_ERRORS_H

#include <math.h>

enum { EY0A, EZ0A, EX0C, EY0C, EZ0T, ER0T, EA0C, EB0C, EC0C, TALC_ERRORS };

#define TALC_GONE_UM 1e-6 /* less is no offset */

typedef struct {
    double wanted[TALC_ERRORS];
    double tip[3];         /* of the tool, from where A and C meet */
    double a;
    double tool[3];        /* length of the tool in use; a change is a step */
    double bound[3];       /* largest offset, either way; a change is a step */
    double limit;          /* largest of any axis, whatever else is going on */
    double radius, reach[2]; /* where ER0T was measured; of the travel in X, and across X from the A axis */
    double slew;           /* µm/s of all together */
    double rate;           /* µm/s of the errors; less than the slew while a watchdog takes them back */
    double dt;
    int homed;             /* otherwise the offsets go to zero */
    int hold;              /* nothing moves */
} TalcInput;

typedef struct {
    double errors[TALC_ERRORS]; /* in force */
    double out[3], bridge[3];
    double tool[3], bound[3];
    int homed, hold;
} TalcState;

static inline double talc_clip(double value, double most) {
    return value > most ? most : value < -most ? -most : value;
}

/* The shift of the tool that follows the point of the workpiece at its tip. */
static inline void talc_offsets(const double e[], const double tip[3], double a, double radius, double out[3]) {
    const double c = cos(a), s = sin(a);
    const double x = tip[0] * 1e-3, y = (c * tip[1] + s * tip[2]) * 1e-3, z = (c * tip[2] - s * tip[1]) * 1e-3;
    const double growth = e[ER0T] * 1e3 / radius;
    const double u = e[EX0C] + growth * x + e[EB0C] * z - e[EC0C] * y;
    const double v = e[EY0C] + growth * y - e[EA0C] * z + e[EC0C] * x;
    const double w = e[EZ0T] + e[EA0C] * y - e[EB0C] * x;
    out[0] = u;
    out[1] = e[EY0A] + c * v - s * w;
    out[2] = e[EZ0A] + s * v + c * w;
}

/* How fast the offset of any axis can move, anywhere, when the errors move by `e`. */
static inline double talc_size(const double e[], double radius, const double reach[2]) {
    const double along = reach[0] * 1e-3, across = reach[1] * 1e-3, grown = fabs(e[ER0T]) * 1e3 / radius;
    const double both = fabs(e[EY0C]) + fabs(e[EZ0T]) + grown * across + fabs(e[EA0C]) * across
        + (fabs(e[EB0C]) + fabs(e[EC0C])) * along;
    const double x = fabs(e[EX0C]) + grown * along + (fabs(e[EB0C]) + fabs(e[EC0C])) * across;
    return fmax(x, both + fmax(fabs(e[EY0A]), fabs(e[EZ0A])));
}

static inline int talc_finite(const double values[], int count) {
    for (int i = 0; i < count; i++)
        if (!isfinite(values[i])) return 0;
    return 1;
}

static inline int talc_differ(const double a[3], const double b[3]) {
    return a[0] != b[0] || a[1] != b[1] || a[2] != b[2];
}

/* One servo period. What is not a number moves nothing. */
static inline void talc_step(TalcState *s, const TalcInput *in) {
    double target[3], way[TALC_ERRORS];
    double reach[2] = {fmax(in->reach[0], fabs(in->tip[0])), fmax(in->reach[1], hypot(in->tip[1], in->tip[2]))};
    if (!talc_finite(in->tip, 3) || !isfinite(in->a) || in->hold) {
        s->hold = 1;
        return;
    }
    const int bridged = fabs(s->bridge[0]) + fabs(s->bridge[1]) + fabs(s->bridge[2]) > TALC_GONE_UM;
    const double moves = fmin(in->rate, bridged ? in->slew / 2 : in->slew) * in->dt;
    if (talc_finite(in->wanted, TALC_ERRORS)) {
        for (int i = 0; i < TALC_ERRORS; i++) way[i] = in->wanted[i] - s->errors[i];
        const double size = talc_size(way, in->radius, reach);
        for (int i = 0; i < TALC_ERRORS; i++)
            s->errors[i] = size <= moves ? in->wanted[i] : s->errors[i] + way[i] * (moves / size);
    }
    target[0] = target[1] = target[2] = 0.0;
    if (in->homed) {
        talc_offsets(s->errors, in->tip, in->a, in->radius, target);
        for (int i = 0; i < 3; i++) target[i] = talc_clip(target[i], in->bound[i]);
    }
    if (s->hold || in->homed != s->homed || talc_differ(in->tool, s->tool) || talc_differ(in->bound, s->bound))
        for (int i = 0; i < 3; i++) s->bridge[i] = s->out[i] - target[i];
    for (int i = 0; i < 3; i++) {
        s->bridge[i] -= talc_clip(s->bridge[i], in->slew / 2 * in->dt);
        s->out[i] = talc_clip(target[i] + s->bridge[i], in->limit);
        s->tool[i] = in->tool[i];
        s->bound[i] = in->bound[i];
    }
    s->homed = in->homed;
    s->hold = 0;
}

#endif
