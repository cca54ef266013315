#include "kernel.h"

#ifndef CARDAN_VERSION
#error "tools/native defines CARDAN_VERSION, the package's version"
#endif

const char *kernel_version(void)
{
    return CARDAN_VERSION;
}

#define AT(type, field) offsetof(type, field)

/* Every field, in the order of cardan/gateway/servo/kernel_layout.py. */
static const size_t LAYOUT[] = {
    sizeof(KernelArm),
    AT(KernelArm, joints), AT(KernelArm, prismatic), AT(KernelArm, rotation),
    AT(KernelArm, position), AT(KernelArm, axis), AT(KernelArm, lower), AT(KernelArm, upper),
    AT(KernelArm, velocity), AT(KernelArm, acceleration), AT(KernelArm, weights),
    sizeof(KernelOptions),
    AT(KernelOptions, length_m), AT(KernelOptions, gain_1_s), AT(KernelOptions, linear_speed_m_s),
    AT(KernelOptions, angular_speed_rad_s), AT(KernelOptions, linear_deceleration_m_s2),
    AT(KernelOptions, angular_deceleration_rad_s2), AT(KernelOptions, joint_gain_1_s),
    AT(KernelOptions, damping), AT(KernelOptions, singular_below),
    AT(KernelOptions, damping_floor), AT(KernelOptions, path_stiffness),
    AT(KernelOptions, posture_gain_1_s), AT(KernelOptions, posture_weight),
    sizeof(KernelShape),
    AT(KernelShape, kind), AT(KernelShape, body), AT(KernelShape, start), AT(KernelShape, end),
    AT(KernelShape, radius_m), AT(KernelShape, rotation), AT(KernelShape, position),
    AT(KernelShape, half_m), AT(KernelShape, normal), AT(KernelShape, offset_m),
    sizeof(KernelPair),
    AT(KernelPair, first), AT(KernelPair, second), AT(KernelPair, safety_m),
    AT(KernelPair, deceleration_m_s2), AT(KernelPair, sweep),
    sizeof(KernelState),
    AT(KernelState, q), AT(KernelState, v), AT(KernelState, goal_position),
    AT(KernelState, goal_orientation), AT(KernelState, goal_twist), AT(KernelState, joint_rate),
    AT(KernelState, goal_joints), AT(KernelState, goal_rate), AT(KernelState, posture),
    AT(KernelState, twist), AT(KernelState, motion), AT(KernelState, reachable_position),
    AT(KernelState, reachable_orientation), AT(KernelState, pose_joints),
    AT(KernelState, pose_position),
    AT(KernelState, pose_orientation), AT(KernelState, joint_error),
    AT(KernelState, path_speed), AT(KernelState, smallest_singular_value), AT(KernelState, damping),
    AT(KernelState, distance_m), AT(KernelState, error_m), AT(KernelState, error_rad),
    AT(KernelState, unreachable_m_s), AT(KernelState, unreachable_rad_s),
    AT(KernelState, has_posture), AT(KernelState, reach), AT(KernelState, problem),
    AT(KernelState, active), AT(KernelState, nearest), AT(KernelState, limiting),
    AT(KernelState, iterations), AT(KernelState, most_iterations), AT(KernelState, failures),
    AT(KernelState, moving),
    sizeof(Program),
    AT(Program, unknowns), AT(Program, rows), AT(Program, hessian), AT(Program, linear),
    AT(Program, lowest), AT(Program, highest), AT(Program, row), AT(Program, least),
    AT(Program, row_name), AT(Program, x), AT(Program, multiplier),
    AT(Program, iterations), AT(Program, warm_count), AT(Program, warm_name),
    AT(Program, warm_multiplier), AT(Program, factor), AT(Program, inverse),
    AT(Program, shift), AT(Program, y), AT(Program, normal), AT(Program, size),
    AT(Program, low), AT(Program, high), AT(Program, count), AT(Program, member),
    AT(Program, is_high), AT(Program, position), AT(Program, lambda), AT(Program, target),
    AT(Program, gram), AT(Program, lower), AT(Program, diagonal),
};

size_t kernel_layout(const size_t **values)
{
    *values = LAYOUT;
    return sizeof LAYOUT / sizeof *LAYOUT;
}
