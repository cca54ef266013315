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
    AT(KernelState, pose_orientation), AT(KernelState, path_speed),
    AT(KernelState, smallest_singular_value), AT(KernelState, damping),
    AT(KernelState, distance_m), AT(KernelState, error_m), AT(KernelState, error_rad),
    AT(KernelState, unreachable_m_s), AT(KernelState, unreachable_rad_s),
    AT(KernelState, has_posture), AT(KernelState, reach), AT(KernelState, problem),
    AT(KernelState, active), AT(KernelState, nearest), AT(KernelState, limiting),
    AT(KernelState, iterations), AT(KernelState, most_iterations), AT(KernelState, failures),
    AT(KernelState, moving),
    sizeof(Programme),
    AT(Programme, unknowns), AT(Programme, rows), AT(Programme, hessian), AT(Programme, linear),
    AT(Programme, lowest), AT(Programme, highest), AT(Programme, row), AT(Programme, least),
    AT(Programme, row_name), AT(Programme, x), AT(Programme, multiplier),
    AT(Programme, iterations), AT(Programme, warm_count), AT(Programme, warm_name),
    AT(Programme, warm_multiplier), AT(Programme, factor), AT(Programme, inverse),
    AT(Programme, shift), AT(Programme, y), AT(Programme, normal), AT(Programme, size),
    AT(Programme, low), AT(Programme, high), AT(Programme, count), AT(Programme, member),
    AT(Programme, is_high), AT(Programme, position), AT(Programme, lambda), AT(Programme, target),
    AT(Programme, gram), AT(Programme, lower), AT(Programme, diagonal),
};

size_t kernel_layout(const size_t **values)
{
    *values = LAYOUT;
    return sizeof LAYOUT / sizeof *LAYOUT;
}
