/* Sizes and offsets of the structures of tick.h, for bindings to compare with their own. */
#include <stddef.h>

#include "tick.h"

#define F(type, field) offsetof(type, field)

static const size_t layout[] = {
    sizeof(TickLimits), F(TickLimits, clamp_n), F(TickLimits, slew_rise_n_s),
    F(TickLimits, slew_fall_n_s), F(TickLimits, release_s), F(TickLimits, engage_ramp_s),
    F(TickLimits, engage_below_n), F(TickLimits, hold_s), F(TickLimits, pause_s),
    F(TickLimits, measured_hold_s), F(TickLimits, velocity_gate_m_s),
    F(TickLimits, damping_n_s_m), F(TickLimits, velocity_cutoff_hz), F(TickLimits, continuous_n),
    F(TickLimits, continuous_window_s), F(TickLimits, thermal_derating_s),
    F(TickLimits, temperature_limit), F(TickLimits, alpha_max_n_s_m),
    F(TickLimits, energy_budget_j), F(TickLimits, prediction_error_m), F(TickLimits, leak_s),
    F(TickLimits, workspace_lower_m), F(TickLimits, workspace_upper_m),
    F(TickLimits, edge_stiffness_n_m), F(TickLimits, extrapolate_s), F(TickLimits, overrun_gap_s),
    F(TickLimits, pause_gap_s), F(TickLimits, oscillation_window_s), F(TickLimits, oscillation_speed_m_s),
    F(TickLimits, force_error_wait_s), F(TickLimits, torque_limit_n_m),
    F(TickLimits, lowest_rate_hz), F(TickLimits, engage_ticks), F(TickLimits, oscillation_reversals),
    F(TickLimits, passivity), F(TickLimits, unchecked),

    sizeof(TickFixture), F(TickFixture, kind), F(TickFixture, inside), F(TickFixture, point),
    F(TickFixture, axis), F(TickFixture, rotation), F(TickFixture, radius_m),
    F(TickFixture, stiffness_n_m), F(TickFixture, cap_n), F(TickFixture, damping_n_s_m),

    sizeof(TickCommand), F(TickCommand, sequence), F(TickCommand, stamp_s),
    F(TickCommand, engaged), F(TickCommand, fixture_count), F(TickCommand, has_measured),
    F(TickCommand, has_torques), F(TickCommand, linear), F(TickCommand, offset),
    F(TickCommand, rotation), F(TickCommand, force), F(TickCommand, force_scale),
    F(TickCommand, torques_n_m), F(TickCommand, measured_force),
    F(TickCommand, measured_stamp_s), F(TickCommand, measured_rate_n_s),
    F(TickCommand, measured_position), F(TickCommand, measured_stiffness_n_m),
    F(TickCommand, fixtures),

    sizeof(TickSample), F(TickSample, now_s), F(TickSample, position), F(TickSample, velocity),
    F(TickSample, rotation), F(TickSample, joints_rad), F(TickSample, gimbal_rad),
    F(TickSample, jacobian), F(TickSample, temperature), F(TickSample, cost_s),
    F(TickSample, encoders), F(TickSample, buttons), F(TickSample, inkwell),
    F(TickSample, calibrated), F(TickSample, calibration), F(TickSample, by_torque),
    F(TickSample, unsound),

    sizeof(TickOutput), F(TickOutput, force), F(TickOutput, torques_n_m),
    F(TickOutput, torque_mode), F(TickOutput, state),

    sizeof(TickSnapshot), F(TickSnapshot, stamp_s), F(TickSnapshot, ticks),
    F(TickSnapshot, state), F(TickSnapshot, reason), F(TickSnapshot, position),
    F(TickSnapshot, velocity), F(TickSnapshot, rotation), F(TickSnapshot, joints_rad),
    F(TickSnapshot, gimbal_rad), F(TickSnapshot, force_commanded), F(TickSnapshot, force),
    F(TickSnapshot, torques_n_m), F(TickSnapshot, energy_j), F(TickSnapshot, delivered_j),
    F(TickSnapshot, passivity_damping_n_s_m), F(TickSnapshot, thermal_derating),
    F(TickSnapshot, temperature), F(TickSnapshot, command_sequence), F(TickSnapshot, command_age_s),
    F(TickSnapshot, force_age_s), F(TickSnapshot, gap_s), F(TickSnapshot, tick_cost_s),
    F(TickSnapshot, rate_hz), F(TickSnapshot, encoders), F(TickSnapshot, buttons),
    F(TickSnapshot, inkwell), F(TickSnapshot, calibrated), F(TickSnapshot, calibration),
    F(TickSnapshot, presses), F(TickSnapshot, late_ticks), F(TickSnapshot, stale_commands),
    F(TickSnapshot, faults), F(TickSnapshot, oscillations), F(TickSnapshot, errors),
    F(TickSnapshot, force_errors), F(TickSnapshot, error), F(TickSnapshot, internal_error),
    F(TickSnapshot, realtime), F(TickSnapshot, finished), F(TickSnapshot, peak_n),
    F(TickSnapshot, given_peak_j), F(TickSnapshot, rendering),
    F(TickSnapshot, bad_readings),
};

size_t tick_layout(const size_t **values)
{
    *values = layout;
    return sizeof layout / sizeof *layout;
}
