#include "energy.h"

#include <math.h>

#include "vectors.h"

#define BISECTIONS 12

double most_work(const double force[3], const double sent[3], const double moved[3], double fall,
                 double error)
{
    double size = norm(force);
    double speed = size > 0.0 ? dot(force, moved) / size : 0.0;
    double work = fmax(size * (speed + error), dot(sent, moved) + norm(sent) * error);
    for (int j = 2; size > 0.0; j++) {
        double next = fmax(0.0, size - fall);
        double farther = speed + j * error;
        work += fmax(size * farther, next * farther);
        size = next;
    }
    return work;
}

static bool slew_allows(const double from[3], const double to[3], double rise, double fall)
{
    double d[3] = {to[0] - from[0], to[1] - from[1], to[2] - from[2]};
    return norm(d) <= (norm(to) > norm(from) ? rise : fall) * (1.0 + 1e-12);
}

void slew(double to[3], const double from[3], const double target[3], double rise, double fall)
{
    double d[3] = {target[0] - from[0], target[1] - from[1], target[2] - from[2]};
    double distance = norm(d), size = norm(from);
    set(to, from);
    if (distance <= 0.0)
        return;
    add(to, fmin(1.0, fall / distance), d);
    if (norm(to) > size) {
        set(to, from);
        add(to, fmin(1.0, rise / distance), d);
    }
}

bool spare_energy(Tick *tick, double force[3], double rise, double fall, double tank)
{
    double moved[3], step = tick->limits.slew_fall_n_s * tick->period_s;
    double error = tick->limits.prediction_error_m;
    double most = fmax(tank, 0.0);
    set(moved, tick->moved);
    if (most_work(force, tick->sent, moved, step, error) <= most)
        return false;
    double length = norm(moved), away = 0.0;
    double idle[3];
    set(idle, force);
    if (length > 0.0 && (away = dot(force, moved) / length) > 0.0) {
        double bare[3];
        set(bare, force);
        add(bare, -away / length, moved);
        slew(idle, tick->sent, bare, rise, fall);
    }
    double safe[3], from[3], to[3];
    set(to, force);
    if (most_work(idle, tick->sent, moved, step, error) <= most) {
        set(safe, idle);
    } else {
        set(to, idle);
        set(safe, tick->sent);
        double size = norm(safe);
        add(safe, size > fall ? -fall / size : -1.0, tick->sent);
    }
    set(from, safe);
    double low = 0.0, high = 1.0;
    for (int i = 0; i < BISECTIONS; i++) {
        double middle = 0.5 * (low + high), tried[3];
        for (int j = 0; j < 3; j++)
            tried[j] = from[j] + middle * (to[j] - from[j]);
        if (most_work(tried, tick->sent, moved, step, error) <= most &&
            slew_allows(tick->sent, tried, rise, fall)) {
            low = middle;
            set(safe, tried);
        } else {
            high = middle;
        }
    }
    set(force, safe);
    return true;
}
