#include "answer.h"
#include "pose.h"
#include "take.h"

#ifndef CARDAN_VERSION
#error "tools/native defines CARDAN_VERSION, the package's version"
#endif

const char *egm_version(void)
{
    return CARDAN_VERSION;
}

#define AT(type, field) offsetof(type, field)

/* Every field, in the order of cardan/drivers/abb_egm/compiled.py. */
static const size_t LAYOUT[] = {
    sizeof(EgmAnswer),
    AT(EgmAnswer, limits.lower), AT(EgmAnswer, limits.upper),
    AT(EgmAnswer, limits.inner_lower), AT(EgmAnswer, limits.inner_upper),
    AT(EgmAnswer, limits.speed), AT(EgmAnswer, limits.acceleration),
    AT(EgmAnswer, largest_position), AT(EgmAnswer, largest_velocity), AT(EgmAnswer, delay_s),
    AT(EgmAnswer, target), AT(EgmAnswer, reference), AT(EgmAnswer, velocity),
    AT(EgmAnswer, positions), AT(EgmAnswer, velocities), AT(EgmAnswer, measured),
    AT(EgmAnswer, has_target), AT(EgmAnswer, says), AT(EgmAnswer, moving), AT(EgmAnswer, relocates),
    AT(EgmAnswer, reply),
    sizeof(EgmPoint),
    AT(EgmPoint, lower), AT(EgmPoint, upper), AT(EgmPoint, speed), AT(EgmPoint, acceleration),
    AT(EgmPoint, target), AT(EgmPoint, reference), AT(EgmPoint, velocity), AT(EgmPoint, has_box),
    AT(EgmPoint, has_target),
    sizeof(EgmTurn),
    AT(EgmTurn, speed), AT(EgmTurn, acceleration), AT(EgmTurn, target), AT(EgmTurn, reference),
    AT(EgmTurn, velocity), AT(EgmTurn, has_target),
    sizeof(EgmPoseAnswer),
    AT(EgmPoseAnswer, largest_position), AT(EgmPoseAnswer, largest_linear),
    AT(EgmPoseAnswer, largest_angular), AT(EgmPoseAnswer, shortest_squared),
    AT(EgmPoseAnswer, longest_squared), AT(EgmPoseAnswer, delay_s), AT(EgmPoseAnswer, point),
    AT(EgmPoseAnswer, turn), AT(EgmPoseAnswer, position), AT(EgmPoseAnswer, orientation),
    AT(EgmPoseAnswer, linear), AT(EgmPoseAnswer, angular), AT(EgmPoseAnswer, measured_position),
    AT(EgmPoseAnswer, measured_orientation), AT(EgmPoseAnswer, says), AT(EgmPoseAnswer, moving),
    AT(EgmPoseAnswer, relocates), AT(EgmPoseAnswer, reply),
    sizeof(EgmLayout),
    AT(EgmLayout, length), AT(EgmLayout, forces), AT(EgmLayout, has_rate), AT(EgmLayout, states),
    AT(EgmLayout, place), AT(EgmLayout, size), AT(EgmLayout, mask), AT(EgmLayout, fixed),
    sizeof(EgmReader),
    AT(EgmReader, joints), AT(EgmReader, position), AT(EgmReader, orientation), AT(EgmReader, rate),
    AT(EgmReader, forces), AT(EgmReader, time_us), AT(EgmReader, seqno), AT(EgmReader, tm_ms),
    AT(EgmReader, newest),
    AT(EgmReader, layouts),
    sizeof(EgmCycle),
    AT(EgmCycle, nominal_s), AT(EgmCycle, lost_after_s), AT(EgmCycle, late_after_s),
    AT(EgmCycle, longest_gap_s), AT(EgmCycle, jump), AT(EgmCycle, jump_per_s), AT(EgmCycle, usual),
    AT(EgmCycle, rounding), AT(EgmCycle, shortest_squared), AT(EgmCycle, longest_squared),
    AT(EgmCycle, slack_s), AT(EgmCycle, most_credit_s),
    AT(EgmCycle, by_joints), AT(EgmCycle, states), AT(EgmCycle, tm_ms), AT(EgmCycle, time_us),
    AT(EgmCycle, last_step_s), AT(EgmCycle, since_reply_s), AT(EgmCycle, credit_s),
    AT(EgmCycle, replied_s), AT(EgmCycle, out_seqno), AT(EgmCycle, said_speed),
    AT(EgmCycle, steady), AT(EgmCycle, known), AT(EgmCycle, last_s), AT(EgmCycle, joints), AT(EgmCycle, position),
    AT(EgmCycle, orientation), AT(EgmCycle, seqno), AT(EgmCycle, layout), AT(EgmCycle, jitter_s), AT(EgmCycle, turned),
};

size_t egm_layout(const size_t **values)
{
    *values = LAYOUT;
    return sizeof LAYOUT / sizeof *LAYOUT;
}
