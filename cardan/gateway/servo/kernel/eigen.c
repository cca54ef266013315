#include "eigen.h"

#include <float.h>
#include <math.h>
#include <stdbool.h>
#include <stddef.h>
#include <string.h>

/* Householder: `a` becomes the orthogonal matrix where wanted; diagonal and lower diagonal out. */
static void tridiagonal(int n, double a[MAX_JOINTS][MAX_JOINTS], double *diagonal, double *lower,
                        double (*turn)[MAX_JOINTS])
{
    if (turn)
        for (int i = 0; i < n; i++)
            for (int j = 0; j < n; j++)
                turn[i][j] = i == j;
    for (int k = 0; k + 2 < n; k++) {
        double square = 0.0, v[MAX_JOINTS], p[MAX_JOINTS];
        for (int i = k + 2; i < n; i++)
            square += a[i][k] * a[i][k];
        if (square <= DBL_MIN)
            continue;
        double first = a[k + 1][k], length = sqrt(square + first * first);
        double pivot = first > 0.0 ? -length : length;
        v[k + 1] = first - pivot;
        for (int i = k + 2; i < n; i++)
            v[i] = a[i][k];
        double gain = 2.0 / (square + v[k + 1] * v[k + 1]), half = 0.0;
        for (int i = k + 1; i < n; i++) {
            double sum = 0.0;
            for (int j = k + 1; j < n; j++)
                sum += a[i][j] * v[j];
            p[i] = gain * sum;
            half += p[i] * v[i];
        }
        half *= 0.5 * gain;
        for (int i = k + 1; i < n; i++)
            p[i] -= half * v[i];
        for (int i = k + 1; i < n; i++)
            for (int j = k + 1; j < n; j++)
                a[i][j] -= v[i] * p[j] + p[i] * v[j];
        a[k + 1][k] = pivot;
        if (turn)
            for (int i = 0; i < n; i++) {
                double sum = 0.0;
                for (int j = k + 1; j < n; j++)
                    sum += turn[i][j] * v[j];
                for (int j = k + 1; j < n; j++)
                    turn[i][j] -= gain * sum * v[j];
            }
        for (int i = k + 2; i < n; i++)
            a[i][k] = 0.0;
    }
    for (int i = 0; i < n; i++)
        diagonal[i] = a[i][i];
    for (int i = 0; i + 1 < n; i++)
        lower[i] = a[i + 1][i];
}

/* One implicit QL step with shift on the block from `first` to `last`. */
static void ql_step(int n, int first, int last, double *d, double *e, double (*turn)[MAX_JOINTS])
{
    double slope = (d[first + 1] - d[first]) / (2.0 * e[first]);
    double root = sqrt(slope * slope + 1.0);
    double g = d[last] - d[first] + e[first] / (slope + (slope < 0.0 ? -root : root));
    double sine = 1.0, cosine = 1.0, p = 0.0;
    for (int i = last - 1; i >= first; i--) {
        double f = sine * e[i], b = cosine * e[i];
        double length = sqrt(f * f + g * g);
        if (i + 1 < last)
            e[i + 1] = length;
        if (length == 0.0) {
            d[i + 1] -= p;
            return;
        }
        sine = f / length;
        cosine = g / length;
        g = d[i + 1] - p;
        double r = (d[i] - g) * sine + 2.0 * cosine * b;
        p = sine * r;
        d[i + 1] = g + p;
        g = cosine * r - b;
        if (turn)
            for (int row = 0; row < n; row++) {
                double second = turn[row][i + 1], one = turn[row][i];
                turn[row][i + 1] = sine * one + cosine * second;
                turn[row][i] = cosine * one - sine * second;
            }
    }
    d[first] -= p;
    e[first] = g;
    if (last + 1 < n)
        e[last] = 0.0;
}

int eigen_symmetric(int n, const double matrix[MAX_JOINTS][MAX_JOINTS], double values[MAX_JOINTS],
                    double (*vectors)[MAX_JOINTS])
{
    double a[MAX_JOINTS][MAX_JOINTS], lower[MAX_JOINTS] = {0.0};
    memcpy(a, matrix, sizeof a);
    tridiagonal(n, a, values, lower, vectors);
    for (int first = 0; first < n; first++) {
        for (int step = 0;; step++) {
            int last = first;
            for (; last + 1 < n; last++)
                if (!(fabs(lower[last]) > DBL_EPSILON * (fabs(values[last]) + fabs(values[last + 1]))))
                    break;
            if (last == first)
                break;
            if (step == EIGEN_STEPS)
                return false;
            ql_step(n, first, last, values, lower, vectors);
        }
    }
    for (int i = 0; i < n; i++) {
        int least = i;
        for (int j = i + 1; j < n; j++)
            if (values[j] < values[least])
                least = j;
        double value = values[i];
        values[i] = values[least];
        values[least] = value;
        if (vectors && least != i)
            for (int row = 0; row < n; row++) {
                value = vectors[row][i];
                vectors[row][i] = vectors[row][least];
                vectors[row][least] = value;
            }
    }
    return true;
}

double eigen_smallest(int n, double matrix[MAX_JOINTS][MAX_JOINTS])
{
    double diagonal[MAX_JOINTS], lower[MAX_JOINTS] = {0.0}, norm = 0.0, at = 0.0, before = 0.0;
    tridiagonal(n, matrix, diagonal, lower, NULL);
    for (int i = 0; i < n; i++) {
        norm = norm > diagonal[i] ? norm : diagonal[i];
        lower[i] *= lower[i];
    }
    for (int step = 0; step < EIGEN_STEPS; step++) {
        /* Of the polynomial as the product of pivots: sums of 1 / (value - at), and of its square. */
        double square = 0.0, share = 0.0, second = 0.0, first_sum = 0.0, second_sum = 0.0;
        for (int i = 0; i < n; i++) {
            double pivot = diagonal[i] - at - square;
            if (!(pivot > 0.0))
                return at;
            double inverse = 1.0 / pivot;
            second = square * (second - 2.0 * share * share) * inverse;
            share = (square * share - 1.0) * inverse;
            first_sum -= share;
            second_sum += share * share - second;
            square = lower[i] * inverse;
        }
        double spread = (n - 1) * (n * second_sum - first_sum * first_sum);
        double away = n / (first_sum + (spread > 0.0 ? sqrt(spread) : 0.0));
        if (!(away > 0.0))
            return at;
        at += away;
        /* The next is less by the third power of that, or as much where values are the same. */
        double less = away / before;
        if (away * less * less * less < DBL_EPSILON * (at + norm * DBL_EPSILON))
            return at;
        before = away;
    }
    return at;
}
