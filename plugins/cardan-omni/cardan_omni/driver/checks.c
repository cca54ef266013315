#include "checks.h"

#include <math.h>
#include <stddef.h>
#include <string.h>

#include "tick_internal.h"
#include "vectors.h"

#define LONGEST_RELEASE_S 0.05 /* most_work() counts its ticks one by one */

#define R(field, low, high) {offsetof(TickLimits, field), low, high}

/* Ranges that a device may be driven with: limits.py has the reasons. */
static const struct {
    size_t at;
    double low, high;
} ranges[] = {
    R(clamp_n, 0.01, 3.3),
    R(slew_rise_n_s, 1.0, 400.0),
    R(slew_fall_n_s, 1.0, 3300.0),
    R(release_s, 0.001, 0.05),
    R(engage_ramp_s, 0.01, 10.0),
    R(engage_below_n, 0.001, 0.5),
    R(hold_s, 0.001, 0.2),
    R(pause_s, 0.001, 1.0),
    R(measured_hold_s, 0.001, 0.2),
    R(velocity_gate_m_s, 0.2, 2.0),
    R(damping_n_s_m, 0.0, 3.0),
    R(velocity_cutoff_hz, 5.0, 100.0),
    R(continuous_n, 0.01, 1.5),
    R(continuous_window_s, 1.0, 30.0),
    R(thermal_derating_s, 0.05, 10.0),
    R(temperature_limit, 0.05, 1.0),
    R(alpha_max_n_s_m, 0.0, 10.0),
    R(energy_budget_j, 0.0, 0.2),
    R(prediction_error_m, 1e-5, 1e-3),
    R(leak_s, 0.01, 60.0),
    R(edge_stiffness_n_m, 0.0, 500.0),
    R(extrapolate_s, 0.0, 0.05),
    R(overrun_gap_s, 0.0012, 0.02),
    R(pause_gap_s, 0.002, 0.1),
    R(oscillation_window_s, 0.02, 1.0),
    R(oscillation_speed_m_s, 0.001, 0.2),
    R(force_error_wait_s, 0.1, 10.0),
    R(torque_limit_n_m, 0.01, 0.5),
    R(lowest_rate_hz, 800.0, 960.0),
};

#undef R

static bool limits_are_in_range(const TickLimits *l)
{
    for (size_t i = 0; i < sizeof ranges / sizeof *ranges; i++) {
        double value;
        memcpy(&value, (const char *)l + ranges[i].at, sizeof value);
        if (value < ranges[i].low || value > ranges[i].high)
            return false;
    }
    for (int i = 0; i < 3; i++)
        if (l->workspace_lower_m[i] < -1.0 || l->workspace_upper_m[i] > 1.0)
            return false;
    return l->engage_ticks <= 10000;
}

bool limits_are_sound(const TickLimits *l)
{
    if (!l->unchecked && !limits_are_in_range(l))
        return false;
    if (!finite_all(&l->clamp_n, offsetof(TickLimits, engage_ticks) / sizeof(double)))
        return false;
    for (int i = 0; i < 3; i++)
        if (!(l->workspace_lower_m[i] < l->workspace_upper_m[i]))
            return false;
    return l->clamp_n > 0.0 && l->clamp_n <= 3.3 && l->slew_rise_n_s > 0.0 && l->release_s > 0.0 &&
           l->release_s <= LONGEST_RELEASE_S &&
           l->slew_fall_n_s * l->release_s >= l->clamp_n * (1.0 - 1e-9) &&
           l->engage_ramp_s >= 0.0 && l->engage_below_n > 0.0 && l->hold_s > 0.0 &&
           l->pause_s >= l->hold_s && l->measured_hold_s > 0.0 && l->velocity_gate_m_s > 0.0 &&
           l->damping_n_s_m >= 0.0 && l->velocity_cutoff_hz > 0.0 && l->continuous_n > 0.0 &&
           l->continuous_window_s > 0.0 && l->thermal_derating_s > 0.0 && l->temperature_limit > 0.0 &&
           l->alpha_max_n_s_m >= 0.0 && l->energy_budget_j >= 0.0 &&
           l->prediction_error_m >= 0.0 && l->leak_s > 0.0 && l->edge_stiffness_n_m >= 0.0 &&
           l->extrapolate_s >= 0.0 && l->overrun_gap_s > 0.0 &&
           l->pause_gap_s >= l->overrun_gap_s && l->oscillation_window_s > 0.0 &&
           l->oscillation_speed_m_s > 0.0 && l->force_error_wait_s >= 0.0 &&
           l->torque_limit_n_m > 0.0 && l->lowest_rate_hz >= 0.0 && l->engage_ticks >= 1 &&
           l->oscillation_reversals >= 2 && l->oscillation_reversals <= OSCILLATION_RING;
}

int check_command(const TickCommand *c)
{
    if (c->fixture_count < 0 || c->fixture_count > TICK_FIXTURES)
        return TICK_TOO_MANY_FIXTURES;
    if (!isfinite(c->stamp_s) ||
        !finite_all(c->linear, (offsetof(TickCommand, fixtures) - offsetof(TickCommand, linear)) /
                                   sizeof(double)))
        return TICK_NOT_FINITE;
    if (!is_rotation(c->rotation))
        return TICK_NOT_A_ROTATION;
    if (c->force_scale < 0.0 || c->measured_stiffness_n_m < 0.0)
        return TICK_NEGATIVE;
    for (int i = 0; i < c->fixture_count; i++) {
        const TickFixture *f = c->fixtures + i;
        if (!finite_all(f->point, (sizeof *f - offsetof(TickFixture, point)) / sizeof(double)))
            return TICK_NOT_FINITE;
        if (f->radius_m < 0.0 || f->stiffness_n_m < 0.0 || f->cap_n < 0.0 || f->damping_n_s_m < 0.0)
            return TICK_NEGATIVE;
        if ((f->kind == TICK_PLANE || f->kind == TICK_CYLINDER) &&
            fabs(norm(f->axis) - 1.0) > 1e-6)
            return TICK_NOT_UNIT;
        if (f->kind == TICK_BOX) {
            if (f->axis[0] < 0.0 || f->axis[1] < 0.0 || f->axis[2] < 0.0)
                return TICK_NEGATIVE;
            if (!is_rotation(f->rotation))
                return TICK_NOT_A_ROTATION;
        }
    }
    return TICK_TAKEN;
}
