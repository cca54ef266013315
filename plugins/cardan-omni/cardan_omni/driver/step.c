/* The law of tick.h: one step. */
#include <math.h>
#include <stddef.h>
#include <string.h>

#include "energy.h"
#include "monitors.h"
#include "operating_state.h"
#include "rendering.h"
#include "tick_internal.h"
#include "vectors.h"

#define OSCILLATION_GAIN_FLOOR 0.3
#define OSCILLATION_RECOVERY_S 20.0
#define DERATING_BAND 0.2
#define LONGEST_STEP_S 0.02
/* After a late tick the library's velocity is too large for this long: it divides the distance by its
 * nominal period and smooths the result. The tick's own velocity uses the real period. */
#define LIBRARY_SPEED_SETTLES_S 0.05
#define CALIBRATION_JUMP_M 0.002 /* in a tick; below the velocity gate no motion is so large */
#define STILL_TICKS 20 /* in a row without time passing: the clock stands still */
#define FREE_SPACE_N 0.1 /* commanded; less is below the device's own friction */
#define SURPLUS_J 0.05 /* stored by a spring of 40 N/m at 2 N, which may be given back */
#define ALPHA_SPEED_M_S 0.005
/* After a short stall of the loop the stylus has begun to move along the force that it leant on: the
 * force comes back soon, but not at once. After longer than pause_s it does not come back. */
#define RESUME_RAMP_S 0.1
/* A tick that is late by less lowers the force by one regular step; after one that is later the force
 * falls to zero and comes back by the ramp. */
#define LATE_GRACE_S 0.005
/* After so long without an interruption the force may engage again. */
#define CALM_S 0.5
/* Readings that fail for longer than this latch a fault. */
#define UNSOUND_FAULT_S 0.1

static bool sample_is_finite(const TickSample *s)
{
    return finite_all(&s->now_s, offsetof(TickSample, encoders) / sizeof(double));
}

void tick_begin(Tick *tick)
{
    clear(tick->sent);
    clear(tick->before_sent);
    clear(tick->velocity);
    set(tick->now.force, tick->sent);
    tick->started = tick->located = tick->was_alive = false;
    tick->resumes = tick->broken = tick->slow = false;
    tick->slow_since_s = tick->unsound_since_s = TICK_NEVER;
    tick->phase = OUT;
    tick->period_s = TICK_PERIOD_S;
    tick->still_ticks = 0;
}

void tick_step(Tick *tick, const TickSample *s, TickOutput *output)
{
    TickSnapshot *now = &tick->now;
    const TickLimits *l = &tick->limits;
    if (exchange_take(&tick->limits_exchange))
        tick->limits = tick->limits_buffers[tick->limits_exchange.reader];

    /* Time. A clock that stands still or goes back gives no step of the slew limit. */
    bool numbers = s->unsound ? isfinite(s->now_s) : sample_is_finite(s);
    bool sound = numbers && !s->unsound;
    double now_s = isfinite(s->now_s) ? s->now_s : tick->now_s + tick->period_s;
    double gap = tick->started ? now_s - tick->now_s : TICK_PERIOD_S;
    double dt = within(0.0, gap, LONGEST_STEP_S);
    bool late = tick->started && gap > l->overrun_gap_s;
    tick->now_s = now_s;
    tick->started = true;
    now->ticks++;
    if (isfinite(s->now_s))
        atomic_store_explicit(&tick->clock_s, now_s, memory_order_relaxed);
    tick->own_gap_s = gap;
    tick->own_cost_s = isfinite(s->cost_s) ? s->cost_s : 0.0;
    now->gap_s = fmax(now->gap_s, tick->own_gap_s);
    now->tick_cost_s = fmax(now->tick_cost_s, tick->own_cost_s);
    now->late_ticks += late;
    if (dt > 0.0)
        tick->period_s += 0.02 * (within(0.25e-3, dt, 4e-3) - tick->period_s);
    now->rate_hz = 1.0 / tick->period_s;

    if (exchange_take(&tick->command_exchange)) {
        tick->command = &tick->commands[tick->command_exchange.reader];
        tick->command_seen_s = now_s;
    }
    const TickCommand *c = tick->command;

    uint32_t word = atomic_load(&tick->word);
    uint32_t engagement = c ? tick->engagements[tick->command_exchange.reader] : 0;
    if (word >> 16 != tick->generation || engagement != tick->engagement) {
        tick->generation = word >> 16;
        tick->engagement = engagement;
        tick->anew = true;
        tick->resumes = false;
        tick->phase = OUT;
    }

    /* Work of the force sent last, and motion. A position that jumps because the calibration
     * changed is no motion. */
    double energy_before = tick->energy_j;
    clear(tick->moved);
    if (sound) {
        for (int i = 0; i < 3; i++)
            tick->moved[i] = s->position[i] - tick->position[i];
        bool jump = !s->calibrated != !now->calibrated && norm(tick->moved) > CALIBRATION_JUMP_M;
        if (tick->located && !jump) {
            double work = fmax(dot(tick->sent, tick->moved), dot(tick->before_sent, tick->moved));
            tick->energy_j -= work;
            tick->given_j += work;
            now->delivered_j += work;
            now->given_peak_j = fmax(now->given_peak_j, tick->given_j);
        } else {
            clear(tick->moved);
            clear(tick->velocity);
        }
        set(tick->position, s->position);
        filter_velocity(tick, fmax(tick->located ? now_s - tick->located_s : gap, 0.0));
        tick->located = true;
        tick->located_s = now_s;
        count_buttons(tick, s->buttons, now_s);
        now->stamp_s = now_s;
        set(now->position, s->position);
        memcpy(now->rotation, s->rotation, sizeof now->rotation);
        set(now->joints_rad, s->joints_rad);
        set(now->gimbal_rad, s->gimbal_rad);
        memcpy(now->encoders, s->encoders, sizeof now->encoders);
        now->temperature = s->temperature;
        now->inkwell = s->inkwell;
        now->calibrated = s->calibrated;
        now->calibration = s->calibration;
    }
    now->buttons = tick->buttons;
    set(now->velocity, tick->velocity);

    /* Reasons that forbid force. */
    int reason = TICK_AS_COMMANDED;
    double age = c ? fmax(now_s - c->stamp_s, now_s - tick->command_seen_s) : INFINITY;
    if (c && c->stamp_s > now_s + l->hold_s)
        age = INFINITY; /* stamped in the future: rejected */
    tick->still_ticks = dt > 0.0 ? 0 : tick->still_ticks + 1;
    bool alive = age <= l->hold_s && tick->still_ticks < STILL_TICKS;
    bool fell_silent = !alive && tick->was_alive;
    now->stale_commands += fell_silent;
    tick->was_alive = alive;
    now->command_age_s = age;
    now->command_sequence = c ? c->sequence : 0;

    double force[3] = {0.0, 0.0, 0.0};
    if (c && sound)
        render(tick, s, now_s, force);
    bool finite = finite_all(force, 3);
    if (late)
        tick->distrust_until_s = now_s + LIBRARY_SPEED_SETTLES_S;
    double told = now_s < tick->distrust_until_s ? 0.0 : norm(s->velocity);
    bool fast = fmax(norm(tick->velocity), told) > l->velocity_gate_m_s;
    if (!finite)
        clear(force);
    bool failed = s->unsound && tick->unsound_since_s == TICK_NEVER;
    if (!s->unsound)
        tick->unsound_since_s = TICK_NEVER;
    else if (failed)
        tick->unsound_since_s = now_s;
    now->bad_readings += s->unsound != 0;
    if (!numbers || !finite) {
        latch_fault(tick, &word, TICK_FAULT_NOT_FINITE);
    } else if (s->unsound) {
        if (now_s - tick->unsound_since_s >= UNSOUND_FAULT_S)
            latch_fault(tick, &word, TICK_FAULT_READINGS);
    } else if (fast && s->calibrated && (tick->phase >= RAMPING || norm(tick->sent) > 0.0)) {
        latch_fault(tick, &word, TICK_FAULT_VELOCITY);
    }
    bool let_go = late && gap > LATE_GRACE_S;
    if (!alive || let_go || s->unsound)
        tick->irregular_s = now_s;
    if ((word & 0xffu) == TICK_PAUSED) {
        uint32_t because = word >> 8 & 0xffu;
        if ((because == TICK_PAUSED_IRREGULAR &&
             ((c && !c->engaged) || now_s - tick->irregular_s >= CALM_S)) ||
            ((because == TICK_PAUSED_SILENT || because == TICK_PAUSED_LATE) && alive && !late) ||
            (because == TICK_PAUSED_OSCILLATION && c && !c->engaged))
            change_state(tick, &word, TICK_ENABLED, TICK_AS_COMMANDED);
        else if (because == TICK_PAUSED_LATE && age > l->pause_s)
            change_state(tick, &word, TICK_PAUSED, TICK_PAUSED_SILENT);
    }
    if ((word & 0xffu) == TICK_ENABLED && tick->phase != OUT) {
        if (oscillates(tick, now_s)) {
            now->oscillations++;
            tick->gain *= 0.5;
            if (tick->gain < OSCILLATION_GAIN_FLOOR)
                change_state(tick, &word, TICK_PAUSED, TICK_PAUSED_OSCILLATION);
        }
        if (tick->phase >= RAMPING && c && c->engaged && (fell_silent || let_go || failed)) {
            tick->broken = true;
            if (too_irregular(tick, now_s))
                change_state(tick, &word, TICK_PAUSED, TICK_PAUSED_IRREGULAR);
        }
        if ((word & 0xffu) == TICK_ENABLED && late && gap > l->pause_gap_s &&
            change_state(tick, &word, TICK_PAUSED, TICK_PAUSED_LATE)) {
            tick->resumes = tick->phase >= RAMPING;
            tick->stalled_s = now_s - gap;
        }
    }
    if ((word & 0xffu) == TICK_ENABLED && c && c->engaged && age > l->pause_s)
        change_state(tick, &word, TICK_PAUSED, TICK_PAUSED_SILENT);
    tick->gain = fmin(1.0, tick->gain + dt / OSCILLATION_RECOVERY_S);

    bool hold_phase = false, slow = is_slow(tick, now_s);
    bool inhibited = atomic_load_explicit(&tick->inhibited, memory_order_relaxed) != 0;
    bool away = sound && (!s->calibrated || s->inkwell);
    if ((word & 0xffu) != TICK_ENABLED) {
        reason = (int)(word >> 8 & 0xffu);
    } else if (inhibited) {
        reason = TICK_NO_OUTPUT;
    } else if (slow) {
        reason = TICK_TOO_SLOW;
    } else if (!sound) {
        reason = TICK_NO_READING;
        hold_phase = true;
    } else if (!s->calibrated) {
        reason = TICK_UNCALIBRATED;
    } else if (s->inkwell) {
        reason = TICK_DOCKED;
    } else if (!c) {
        reason = TICK_NO_COMMAND;
    } else if (!c->engaged) {
        reason = TICK_NOT_ENGAGED;
    } else if (!alive) {
        reason = TICK_SILENT;
        hold_phase = true;
    } else if (now_s < tick->quiet_until_s) {
        reason = TICK_AFTER_FORCE_ERROR;
    } else if (late) {
        reason = TICK_LATE;
        hold_phase = true;
    }

    /* Engagement. */
    bool forbidden = reason && reason != TICK_PAUSED_LATE && !hold_phase;
    if (forbidden || inhibited || slow || away || now_s < tick->quiet_until_s || age > l->pause_s ||
        !(fabs(now_s - tick->stalled_s) <= l->pause_s))
        tick->resumes = false;
    if (reason) {
        if (!hold_phase) {
            tick->phase = OUT;
            tick->broken = false;
        }
    } else {
        if (tick->phase == OUT && norm(tick->sent) <= 0.0) {
            tick->phase = WAITING;
            tick->small_ticks = 0;
            if (tick->anew) {
                tick->anew = false;
                tick->energy_j = tick->given_j = energy_before = 0.0;
                forget_oscillation(tick);
                forget_interruptions(tick);
            }
            if (tick->resumes) {
                tick->phase = RAMPING;
                tick->share = 0.0;
                tick->ramp_s = fmin(RESUME_RAMP_S, l->engage_ramp_s);
                tick->resumes = false;
            }
        }
        if (tick->broken && tick->phase >= RAMPING) {
            /* On from what is still out. */
            double asked = norm(force);
            if (asked > 0.0)
                tick->share = fmin(tick->share, norm(tick->sent) / asked);
            if (tick->phase == IN && tick->share < 1.0) {
                tick->phase = RAMPING;
                tick->ramp_s = fmin(RESUME_RAMP_S, l->engage_ramp_s);
            }
        }
        tick->broken = false;
        if (tick->phase == OUT) {
            reason = TICK_NOT_SMALL;
        } else if (tick->phase == WAITING) {
            tick->share = 0.0;
            tick->small_ticks =
                norm(force) < l->engage_below_n && !fast ? tick->small_ticks + 1 : 0;
            if (tick->small_ticks >= l->engage_ticks) {
                tick->phase = RAMPING;
                tick->ramp_s = l->engage_ramp_s;
            }
            reason = TICK_NOT_SMALL;
        } else if (tick->phase == RAMPING) {
            tick->share += tick->ramp_s > 0.0 ? dt / tick->ramp_s : 1.0;
            if (tick->share >= 1.0) {
                tick->share = 1.0;
                tick->phase = IN;
            } else {
                reason = TICK_ENGAGING;
            }
        }
    }

    /* The target. */
    bool rendering = !reason || reason == TICK_ENGAGING;
    bool torque_mode = s->by_torque || (c && c->has_torques);
    double target[3] = {0.0, 0.0, 0.0};
    double alpha = 0.0;
    double mean_most = l->continuous_n * l->continuous_n;
    double heat = fmin(1.0, sqrt(mean_most + fmax(0.0, mean_most - tick->mean_square) *
                                                 l->continuous_window_s / l->thermal_derating_s) /
                                l->clamp_n);
    now->thermal_derating =
        heat * within(0.0, (l->temperature_limit - now->temperature) / DERATING_BAND, 1.0);
    if (rendering) {
        add(target, tick->share * tick->gain, force);
        if (tick->gain < 1.0 && !reason)
            reason = TICK_OSCILLATION;
        if (!c->has_torques)
            add(target, -tick->share * l->damping_n_s_m, tick->velocity);
        double speed2 = dot(tick->velocity, tick->velocity);
        if (l->passivity && tick->energy_j < 0.0 && speed2 > ALPHA_SPEED_M_S * ALPHA_SPEED_M_S) {
            alpha = fmin(l->alpha_max_n_s_m, -tick->energy_j / (tick->period_s * speed2));
            add(target, -alpha, tick->velocity);
        }
        if (torque_mode && limit_torques(target, s->jacobian, l->torque_limit_n_m) && !reason)
            reason = TICK_CLAMPED;
        double most = l->clamp_n * now->thermal_derating;
        if (norm(target) > most) {
            limit_norm(target, most);
            if (!reason)
                reason = now->thermal_derating < 1.0 ? TICK_THERMAL : TICK_CLAMPED;
        }
    }

    /* The force to send. */
    double rise = l->slew_rise_n_s * fmin(dt, l->overrun_gap_s), fall = l->slew_fall_n_s * dt;
    if (tick->still_ticks >= STILL_TICKS)
        fall = l->slew_fall_n_s * TICK_PERIOD_S;
    double sent[3];
    bool graced = reason == TICK_LATE && !let_go;
    slew(sent, tick->sent, target, rise,
         graced ? fmin(fall, l->slew_fall_n_s * TICK_PERIOD_S) : fall);
    if (rendering || graced) {
        double short_of[3] = {target[0] - sent[0], target[1] - sent[1], target[2] - sent[2]};
        if (!reason && norm(short_of) > 1e-9)
            reason = TICK_SLEWING;
        if (l->passivity &&
            spare_energy(tick, sent, rise, fall, tick->energy_j + l->energy_budget_j) && rendering)
            reason = TICK_PASSIVITY;
    }
    if (!finite_all(sent, 3)) {
        clear(sent);
        latch_fault(tick, &word, TICK_FAULT_NOT_FINITE);
    }

    /* A surplus would let a later contact give as much: what damping alone took in is none, it
     * fades while nothing is asked for, and it has an end. But never so that the force that is out
     * could overdraw what is left. */
    if (tick->energy_j > 0.0) {
        double kept = fmin(tick->energy_j, SURPLUS_J);
        if (norm(force) < FREE_SPACE_N)
            kept = fmin(kept, fmax(0.0, energy_before)) * fmax(0.0, 1.0 - dt / l->leak_s);
        double needed = most_work(sent, tick->sent, tick->moved, l->slew_fall_n_s * tick->period_s,
                                  l->prediction_error_m) - l->energy_budget_j;
        tick->energy_j = fmax(kept, fmin(tick->energy_j, needed));
    }

    double torques[3] = {0.0, 0.0, 0.0};
    if (torque_mode && sound)
        limit_torques(sent, s->jacobian, l->torque_limit_n_m); /* the joints have moved since */
    if (sound)
        times_transposed(torques, s->jacobian, sent);
    else
        torque_mode = false;
    set(tick->before_sent, tick->sent);
    set(tick->sent, sent);
    tick->mean_square += (dot(sent, sent) - tick->mean_square) *
                         -expm1(-dt / l->continuous_window_s);

    set(now->force_commanded, force);
    set(now->force, sent);
    now->rendering = rendering;
    now->peak_n = fmax(now->peak_n, norm(sent));
    set(now->torques_n_m, torques);
    now->energy_j = tick->energy_j;
    now->passivity_damping_n_s_m = alpha;
    now->reason = reason;
    set(output->force, sent);
    set(output->torques_n_m, torques);
    output->torque_mode = torque_mode;
    output->state = (int32_t)(word & 0xffu);
    publish(tick);
}
