/* The hand: a spring and a damper to a target that follows waypoints, or that a test moves. */
#include <math.h>
#include <string.h>

#include "omni.h"

/* How fast a hand carries the stylus to the inkwell, and how firmly. */
#define CARRY_M_S 0.25
#define CARRY_N_M 400.0

static const double INKWELL_M[3] = {0.0, -0.0655107, -0.0881142};

static void take(const Waypoint *from, const Waypoint *to, double part, double inverse_span) {
    Hand *hand = &omni.hand;
    for (int i = 0; i < 3; i++) {
        hand->target_m[i] = from->position_m[i] + part * (to->position_m[i] - from->position_m[i]);
        hand->target_velocity_m_s[i] = (to->position_m[i] - from->position_m[i]) * inverse_span;
        hand->turn_rad[i] = from->turn_rad[i] + part * (to->turn_rad[i] - from->turn_rad[i]);
        hand->push_n[i] = from->push_n[i] + part * (to->push_n[i] - from->push_n[i]);
        hand->stiffness_n_m[i] =
            from->stiffness_n_m[i] + part * (to->stiffness_n_m[i] - from->stiffness_n_m[i]);
    }
    hand->gripped = from->gripped;
    hand->buttons = from->buttons;
    hand->docked = from->docked;
}

static void follow_script(double script_s) {
    Hand *hand = &omni.hand;
    const Waypoint *points = omni.settings.waypoints;
    size_t last = omni.settings.waypoint_count - 1;
    double loop_s = omni.settings.loop_s;
    double t = script_s;
    if (loop_s > 0.0) {
        t = fmod(script_s, loop_s);
    }
    if (hand->segment > last || points[hand->segment].time_s > t) {
        hand->segment = 0;
    }
    while (hand->segment < last && points[hand->segment + 1].time_s <= t) {
        hand->segment++;
    }
    const Waypoint *from = &points[hand->segment];
    hand->done = loop_s <= 0.0 && t >= points[last].time_s;
    if (hand->segment == last || t < from->time_s) {
        take(from, from, 0.0, 0.0);
        return;
    }
    const Waypoint *to = from + 1;
    double span_s = to->time_s - from->time_s; /* > 0: the search passes equal times */
    take(from, to, (t - from->time_s) / span_s, 1.0 / span_s);
}

static void carry(double dt_s) {
    Hand *hand = &omni.hand;
    if (!hand->carrying) {
        memcpy(hand->carried_m, omni.arm.position_m, sizeof hand->carried_m);
        hand->carrying = 1;
    }
    double way[3], distance = 0.0;
    for (int i = 0; i < 3; i++) {
        way[i] = INKWELL_M[i] - hand->carried_m[i];
        distance += way[i] * way[i];
    }
    distance = sqrt(distance);
    double part = distance > CARRY_M_S * dt_s ? CARRY_M_S * dt_s / distance : 1.0;
    for (int i = 0; i < 3; i++) {
        hand->carried_m[i] += part * way[i];
        hand->target_m[i] = hand->carried_m[i];
        hand->target_velocity_m_s[i] = part < 1.0 ? part * way[i] / dt_s : 0.0;
        hand->stiffness_n_m[i] = CARRY_N_M;
        hand->push_n[i] = 0.0;
    }
}

void hand_advance(double script_s, double dt_s) {
    Hand *hand = &omni.hand;
    if (hand->scripted) {
        follow_script(script_s);
    }
    if (!hand->docked) {
        hand->carrying = 0;
    } else if (!omni.arm.locked) {
        carry(dt_s);
    }
}

void hand_power_on(void) {
    Hand *hand = &omni.hand;
    for (int i = 0; i < 3; i++) {
        hand->stiffness_n_m[i] = omni.settings.hand_stiffness_n_m;
    }
    hand->gripped = omni.settings.gripped;
    hand->scripted = omni.settings.waypoint_count > 0;
    hand->done = 1;
    if (hand->scripted) {
        follow_script(0.0);
    }
}

void simHand(const double target_m[3], const double turn_rad[3], int gripped,
             const double push_n[3], int buttons, int docked) {
    omni_enter();
    Hand *hand = &omni.hand;
    hand->scripted = 0;
    hand->done = 1;
    for (int i = 0; i < 3; i++) {
        hand->target_m[i] = target_m[i];
        hand->target_velocity_m_s[i] = 0.0;
        hand->turn_rad[i] = turn_rad[i];
        hand->push_n[i] = push_n[i];
        hand->stiffness_n_m[i] = omni.settings.hand_stiffness_n_m;
    }
    hand->gripped = gripped != 0;
    hand->buttons = buttons;
    hand->docked = docked != 0;
    omni_leave();
}
