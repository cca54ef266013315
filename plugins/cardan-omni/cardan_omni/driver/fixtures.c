#include "fixtures.h"

#include "vectors.h"

/* A one-sided spring and damper along the unit `out`; it never pulls. */
static void push_out(double force[3], const TickFixture *f, const double out[3], double depth,
                     const double velocity[3])
{
    if (depth > 0.0) {
        double size = f->stiffness_n_m * depth - f->damping_n_s_m * dot(velocity, out);
        add(force, within(0.0, size, f->cap_n), out);
    }
}

/* Of sphere and cylinder: `d` leads from the middle to the point. */
static void push_round(double force[3], const TickFixture *f, double d[3],
                       const double velocity[3], double last[3])
{
    double distance = norm(d);
    if (distance > 1e-9)
        for (int i = 0; i < 3; i++)
            last[i] = d[i] / distance;
    if (f->inside) {
        double in[3] = {-last[0], -last[1], -last[2]};
        push_out(force, f, in, distance - f->radius_m, velocity);
    } else {
        push_out(force, f, last, f->radius_m - distance, velocity);
    }
}

static void push_box(double force[3], const TickFixture *f, const double d[3],
                     const double velocity[3], double last[3])
{
    double p[3], v[3], push[3] = {0.0, 0.0, 0.0};
    times_transposed(p, f->rotation, d);
    times_transposed(v, f->rotation, velocity);
    if (f->inside) {
        for (int i = 0; i < 3; i++) {
            double in[3] = {0.0, 0.0, 0.0};
            in[i] = p[i] > 0.0 ? -1.0 : 1.0;
            push_out(push, f, in, fabs(p[i]) - f->axis[i], v);
        }
        limit_norm(push, f->cap_n);
    } else {
        int nearest = 0;
        double depth = INFINITY;
        for (int i = 0; i < 3; i++)
            if (f->axis[i] - fabs(p[i]) < depth) {
                depth = f->axis[i] - fabs(p[i]);
                nearest = i;
            }
        if (depth > 0.0) {
            double out[3] = {0.0, 0.0, 0.0};
            if (fabs(p[nearest]) > 1e-9)
                out[nearest] = p[nearest] > 0.0 ? 1.0 : -1.0;
            else if (fabs(last[nearest]) > 0.5)
                out[nearest] = last[nearest];
            else
                out[nearest] = 1.0;
            set(last, out);
            push_out(push, f, out, depth, v);
        }
    }
    double world[3];
    times(world, f->rotation, push);
    add(force, 1.0, world);
}

void push_fixture(double force[3], const TickFixture *f, const double point[3],
                  const double velocity[3], double last[3])
{
    double d[3] = {point[0] - f->point[0], point[1] - f->point[1], point[2] - f->point[2]};
    switch (f->kind) {
    case TICK_SPHERE:
        push_round(force, f, d, velocity, last);
        break;
    case TICK_PLANE:
        push_out(force, f, f->axis, -dot(d, f->axis), velocity);
        break;
    case TICK_BOX:
        push_box(force, f, d, velocity, last);
        break;
    case TICK_CYLINDER:
        add(d, -dot(d, f->axis), f->axis);
        push_round(force, f, d, velocity, last);
        break;
    default: {
        double pull[3] = {0.0, 0.0, 0.0};
        if (f->kind == TICK_SPRING)
            add(pull, -f->stiffness_n_m, d);
        add(pull, -f->damping_n_s_m, velocity);
        limit_norm(pull, f->cap_n);
        add(force, 1.0, pull);
    }
    }
}

void first_direction(double last[3], const TickFixture *f)
{
    clear(last);
    last[2] = 1.0;
    if (f->kind == TICK_CYLINDER) {
        int least = 0;
        for (int i = 1; i < 3; i++)
            if (fabs(f->axis[i]) < fabs(f->axis[least]))
                least = i;
        double other[3] = {0.0, 0.0, 0.0};
        other[least] = 1.0;
        add(other, -f->axis[least], f->axis);
        for (int i = 0; i < 3; i++)
            last[i] = other[i] / norm(other);
    } else if (f->kind == TICK_BOX) {
        clear(last);
    }
}
