#include "rendering.h"

#include <math.h>

#include "fixtures.h"
#include "vectors.h"

#define EDGE_FADE_M 0.02

/* The force that was measured elsewhere, as it may be now. */
static void render_measured(Tick *tick, const TickCommand *c, double now_s, double force[3])
{
    const TickLimits *l = &tick->limits;
    double age = now_s - c->measured_stamp_s;
    tick->now.force_age_s = age;
    if (c->measured_stamp_s != tick->measured_stamp_s) {
        tick->measured_stamp_s = c->measured_stamp_s;
        clear(tick->measured_extra);
        age = within(0.0, age, l->extrapolate_s);
        add(tick->measured_extra, age, c->measured_rate_n_s);
    } else if (age <= l->extrapolate_s) {
        clear(tick->measured_extra);
        add(tick->measured_extra, within(0.0, age, age), c->measured_rate_n_s);
    } else {
        age = INFINITY; /* what was last extrapolated stays */
    }
    if (isfinite(age) && c->measured_stiffness_n_m > 0.0) {
        add(tick->measured_extra, -c->measured_stiffness_n_m, tick->position);
        add(tick->measured_extra, c->measured_stiffness_n_m, c->measured_position);
    }
    if (tick->now.force_age_s < -l->hold_s)
        tick->now.force_age_s = INFINITY; /* stamped in the future: rejected */
    if (tick->now.force_age_s > l->measured_hold_s)
        return;
    double felt[3];
    set(felt, c->measured_force);
    add(felt, 1.0, tick->measured_extra);
    limit_norm(felt, l->clamp_n);
    add(force, 1.0, felt);
}

void render(Tick *tick, const TickSample *s, double now_s, double force[3])
{
    const TickCommand *c = tick->command;
    const TickLimits *l = &tick->limits;
    clear(force);
    tick->now.force_age_s = INFINITY;
    if (c->has_torques) {
        if (!solve_transposed(force, s->jacobian, c->torques_n_m))
            clear(force);
        return;
    }
    double point[3], velocity[3], world[3] = {0.0, 0.0, 0.0};
    times(point, c->linear, tick->position);
    add(point, 1.0, c->offset);
    times(velocity, c->linear, tick->velocity);
    for (int i = 0; i < c->fixture_count; i++) {
        if (tick->direction_kinds[i] != c->fixtures[i].kind) {
            tick->direction_kinds[i] = c->fixtures[i].kind;
            first_direction(tick->directions[i], c->fixtures + i);
        }
        push_fixture(world, c->fixtures + i, point, velocity, tick->directions[i]);
    }
    for (int i = c->fixture_count; i < TICK_FIXTURES; i++)
        tick->direction_kinds[i] = -1;

    double edge[3], outside = 0.0;
    for (int i = 0; i < 3; i++) {
        edge[i] = within(l->workspace_lower_m[i], tick->position[i], l->workspace_upper_m[i]) -
                  tick->position[i];
        outside = fmax(outside, fabs(edge[i]));
    }
    double scale = c->force_scale * within(0.0, 1.0 - outside / EDGE_FADE_M, 1.0);
    double hand[3];
    times_transposed(hand, c->rotation, world);
    add(force, scale, hand);
    if (c->has_measured)
        render_measured(tick, c, now_s, force);
    add(force, 1.0, c->force);
    add(force, l->edge_stiffness_n_m, edge);
}
