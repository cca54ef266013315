/* Vectors of 3 and matrices of 3 x 3, row by row. */
#ifndef CARDAN_OMNI_VECTORS_H
#define CARDAN_OMNI_VECTORS_H

#include <math.h>
#include <stdbool.h>
#include <stddef.h>
#include <string.h>

static inline double dot(const double a[3], const double b[3])
{
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
}

static inline double norm(const double a[3])
{
    return sqrt(dot(a, a));
}

static inline void set(double to[3], const double from[3])
{
    memcpy(to, from, 3 * sizeof(double));
}

static inline void clear(double a[3])
{
    a[0] = a[1] = a[2] = 0.0;
}

static inline void add(double to[3], double factor, const double a[3])
{
    for (int i = 0; i < 3; i++)
        to[i] += factor * a[i];
}

static inline void times(double to[3], const double m[9], const double a[3])
{
    for (int i = 0; i < 3; i++)
        to[i] = m[3 * i] * a[0] + m[3 * i + 1] * a[1] + m[3 * i + 2] * a[2];
}

static inline void times_transposed(double to[3], const double m[9], const double a[3])
{
    for (int i = 0; i < 3; i++)
        to[i] = m[i] * a[0] + m[3 + i] * a[1] + m[6 + i] * a[2];
}

static inline void limit_norm(double a[3], double most)
{
    double size = norm(a);
    if (size > most)
        for (int i = 0; i < 3; i++)
            a[i] *= most / size * (1.0 - 1e-15); /* not above it by rounding either */
}

static inline double within(double low, double value, double high)
{
    return value < low ? low : value > high ? high : value;
}

static inline bool finite_all(const double *values, size_t count)
{
    for (size_t i = 0; i < count; i++)
        if (!isfinite(values[i]))
            return false;
    return true;
}

static inline double determinant(const double m[9])
{
    return m[0] * (m[4] * m[8] - m[5] * m[7]) - m[1] * (m[3] * m[8] - m[5] * m[6]) +
           m[2] * (m[3] * m[7] - m[4] * m[6]);
}

static inline bool is_rotation(const double m[9])
{
    for (int i = 0; i < 3; i++)
        for (int j = i; j < 3; j++)
            if (fabs(dot(m + 3 * i, m + 3 * j) - (i == j)) > 1e-6)
                return false;
    return determinant(m) > 0.0;
}

/* x of transposed(m) x = a; false where that has no sound answer. */
static inline bool solve_transposed(double x[3], const double m[9], const double a[3])
{
    double d = determinant(m);
    if (!(fabs(d) > 1e-5)) /* m^3; 2.94e-3 in the middle of an Omni's room */
        return false;
    x[0] = ((m[4] * m[8] - m[5] * m[7]) * a[0] + (m[5] * m[6] - m[3] * m[8]) * a[1] +
            (m[3] * m[7] - m[4] * m[6]) * a[2]) / d;
    x[1] = ((m[2] * m[7] - m[1] * m[8]) * a[0] + (m[0] * m[8] - m[2] * m[6]) * a[1] +
            (m[1] * m[6] - m[0] * m[7]) * a[2]) / d;
    x[2] = ((m[1] * m[5] - m[2] * m[4]) * a[0] + (m[2] * m[3] - m[0] * m[5]) * a[1] +
            (m[0] * m[4] - m[1] * m[3]) * a[2]) / d;
    return true;
}

/* Shortens a force so that no joint needs a torque above `most`; true if it had to. */
static inline bool limit_torques(double force[3], const double jacobian[9], double most)
{
    double torques[3], largest = 0.0;
    times_transposed(torques, jacobian, force);
    for (int i = 0; i < 3; i++)
        largest = fmax(largest, fabs(torques[i]));
    if (largest <= most)
        return false;
    for (int i = 0; i < 3; i++)
        force[i] *= most / largest;
    return true;
}

#endif
