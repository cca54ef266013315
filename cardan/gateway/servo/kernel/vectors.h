/* Small vectors and rotations. Rotations are 3x3, row by row. */
#ifndef CARDAN_SERVO_VECTORS_H
#define CARDAN_SERVO_VECTORS_H

#include <math.h>

/* fmin and fmax as one instruction: `b` where one of them is no number. */
static inline double smaller(double a, double b)
{
    return a < b ? a : b;
}

static inline double larger(double a, double b)
{
    return a > b ? a : b;
}

static inline double dot3(const double a[3], const double b[3])
{
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
}

static inline double norm3(const double a[3])
{
    return sqrt(dot3(a, a));
}

static inline void copy3(const double a[3], double out[3])
{
    out[0] = a[0];
    out[1] = a[1];
    out[2] = a[2];
}

static inline void subtract3(const double a[3], const double b[3], double out[3])
{
    out[0] = a[0] - b[0];
    out[1] = a[1] - b[1];
    out[2] = a[2] - b[2];
}

/* out = a + share * b */
static inline void along3(const double a[3], double share, const double b[3], double out[3])
{
    out[0] = a[0] + share * b[0];
    out[1] = a[1] + share * b[1];
    out[2] = a[2] + share * b[2];
}

static inline void cross3(const double a[3], const double b[3], double out[3])
{
    out[0] = a[1] * b[2] - a[2] * b[1];
    out[1] = a[2] * b[0] - a[0] * b[2];
    out[2] = a[0] * b[1] - a[1] * b[0];
}

/* out = rotation * a; out is not a. */
static inline void turn3(const double rotation[9], const double a[3], double out[3])
{
    out[0] = dot3(rotation, a);
    out[1] = dot3(rotation + 3, a);
    out[2] = dot3(rotation + 6, a);
}

/* out = transposed rotation * a; out is not a. */
static inline void turn_back3(const double rotation[9], const double a[3], double out[3])
{
    for (int i = 0; i < 3; i++)
        out[i] = rotation[i] * a[0] + rotation[3 + i] * a[1] + rotation[6 + i] * a[2];
}

/* out = a * b; out is neither. */
static inline void multiply33(const double a[9], const double b[9], double out[9])
{
    for (int row = 0; row < 3; row++)
        for (int column = 0; column < 3; column++)
            out[3 * row + column] = a[3 * row] * b[column] + a[3 * row + 1] * b[3 + column] +
                                    a[3 * row + 2] * b[6 + column];
}

static inline double clamp(double value, double low, double high)
{
    return value < low ? low : value > high ? high : value;
}

#endif
