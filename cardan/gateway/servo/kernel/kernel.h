/*
 * The control tick of an arm, compiled: cardan/gateway/servo/servo.py says what it does and why, and
 * this does the same. All memory is taken at construction; no loop is without a bound. One kernel is
 * used by one thread at a time.
 *
 * cardan/gateway/servo/kernel_layout.py mirrors the structures below.
 */
#ifndef CARDAN_SERVO_KERNEL_H
#define CARDAN_SERVO_KERNEL_H

#include <stddef.h>
#include <stdint.h>

#include "bodies.h"
#include "chain.h"
#include "program.h"

#if defined(__GNUC__)
#define KERNEL_API __attribute__((visibility("default")))
#else
#define KERNEL_API
#endif

#define MAX_SHAPES 256
#define MAX_PAIRS 4096

/* The arm, its limits and the weights of its task. Rotations row by row. */
typedef struct {
    int32_t joints;
    int32_t prismatic[MAX_JOINTS];
    double rotation[MAX_JOINTS][9]; /* of the joint in the body before, at zero */
    double position[MAX_JOINTS][3];
    double axis[MAX_JOINTS][3]; /* unit vector in the joint's frame */
    double lower[MAX_JOINTS], upper[MAX_JOINTS]; /* infinite: a joint that turns for ever */
    double velocity[MAX_JOINTS], acceleration[MAX_JOINTS];
    double weights[6]; /* x y z rx ry rz along TCP axes; 0 leaves a direction free */
} KernelArm;

/* ServoOptions, in its order. */
typedef struct {
    double length_m, gain_1_s;
    double linear_speed_m_s, angular_speed_rad_s;
    double linear_deceleration_m_s2, angular_deceleration_rad_s2;
    double joint_gain_1_s;
    double damping, singular_below, damping_floor;
    double path_stiffness;
    double posture_gain_1_s, posture_weight;
} KernelOptions;

typedef struct {
    int32_t first, second;    /* shapes; the body of the second moves more */
    double safety_m;          /* they are kept so far apart */
    double deceleration_m_s2; /* that is expected of them where they close in */
    double sweep[MAX_JOINTS]; /* how much nearer they come per joint motion, at most */
} KernelPair;

/* What stays in place: written by the caller before a call and by the kernel in it. */
typedef struct {
    double q[MAX_JOINTS], v[MAX_JOINTS]; /* commanded joints; written by the kernel only */

    double goal_position[3], goal_orientation[4]; /* w x y z */
    double goal_twist[6];                         /* linear, angular; base axes */
    double joint_rate[MAX_JOINTS];
    double goal_joints[MAX_JOINTS], goal_rate[MAX_JOINTS];
    double posture[MAX_JOINTS];

    double twist[6];                                    /* motion of the reference; base axes */
    double motion[6];                                   /* of the TCP at v; base axes */
    double reachable_position[3], reachable_orientation[4];
    double pose_joints[MAX_JOINTS];                     /* for kernel_pose_at, kernel_measure */
    double pose_position[3], pose_orientation[4];       /* of the TCP in the base */
    double joint_error;                                 /* of kernel_measure */
    double path_speed, smallest_singular_value, damping;
    double distance_m, error_m, error_rad;
    double unreachable_m_s, unreachable_rad_s;

    int32_t has_posture, reach; /* reach: Policy.REACH, else Policy.PATH */
    int32_t problem;            /* of the last call: KERNEL_... below */
    int32_t active, nearest;    /* rows in the program; nearest pair, -1: none */
    int32_t limiting;           /* bit i: joint i is at a bound */
    int32_t iterations, most_iterations; /* of the last tick, and of any */
    int32_t failures;
    int32_t moving;
} KernelState;

enum {
    KERNEL_GOOD,
    KERNEL_BAD_INPUT,  /* a number that is none; it braked */
    KERNEL_BAD_PERIOD, /* not above 0 and at most 10 s; nothing moved */
    KERNEL_NO_SOLUTION /* it braked */
};

/* Reasons why a kernel was not made. */
enum {
    KERNEL_MADE,
    KERNEL_NO_MEMORY,
    KERNEL_BAD_JOINTS,
    KERNEL_BAD_LIMITS,
    KERNEL_BAD_WEIGHTS,
    KERNEL_BAD_OPTIONS,
    KERNEL_BAD_SHAPE,
    KERNEL_BAD_PAIR
};

enum { KERNEL_SLIDE = 1, KERNEL_WITH_RATE = 2 };

typedef struct Kernel Kernel;

/* The package's version that this was compiled for, and sizes and offsets of the structures. */
KERNEL_API const char *kernel_version(void);
KERNEL_API size_t kernel_layout(const size_t **values);

/* NULL, and a reason, where the arm cannot be taken. The tool is the TCP in the last body. */
KERNEL_API Kernel *kernel_create(const KernelArm *arm, const KernelOptions *options,
                                 const KernelShape *shapes, size_t shape_count,
                                 const KernelPair *pairs, size_t pair_count, int32_t *reason);
KERNEL_API void kernel_destroy(Kernel *kernel);

KERNEL_API KernelState *kernel_state(Kernel *kernel);

/* False, and nothing is changed, where a number is none. */
KERNEL_API int32_t kernel_set_tool(Kernel *kernel, const double rotation[9],
                                   const double position[3]);

/* Start from `q`, at rest. False, and nothing is changed, where a number is none, or above 1e9. */
KERNEL_API int32_t kernel_place(Kernel *kernel, const double *q);

/* Go on at `v`. Likewise. */
KERNEL_API int32_t kernel_move_at(Kernel *kernel, const double *v);

/* Put `count` shapes of the base, from `first` on, elsewhere: for each the rotation (row by row) and
 * position of the frame that it is in, and how much farther away than its pairs' distance it is
 * kept. Not half-spaces, which stay. False, and nothing is changed, where a shape is another body's,
 * a placement is none or a distance is not 0 or more. */
KERNEL_API int32_t kernel_move(Kernel *kernel, size_t first, size_t count, const double *placements,
                               const double *grown_m);

/* Servo.tick, Servo.tick_joints and Servo.brake. The path speed. */
KERNEL_API double kernel_tick(Kernel *kernel, double dt_s, int32_t flags);
KERNEL_API double kernel_tick_joints(Kernel *kernel, double dt_s);
KERNEL_API void kernel_brake(Kernel *kernel, double dt_s);

/* Fill in pose_position and pose_orientation, motion and limiting, which no tick needs: of the
 * commanded joints, and of those in pose_joints. */
KERNEL_API void kernel_pose(Kernel *kernel);
KERNEL_API void kernel_pose_at(Kernel *kernel);
KERNEL_API void kernel_motion(Kernel *kernel);
KERNEL_API void kernel_status(Kernel *kernel);

/* ResponseLag of cardan/gateway/servo/response_lag.py: keep the commanded joints of the last `lag_s` (0: of no
 * time), which forgets those before; note those of now. Bit i of `turns`: whole turns of joint i make
 * no difference. */
KERNEL_API void kernel_keep_past(Kernel *kernel, double lag_s, int32_t turns);
KERNEL_API void kernel_note(Kernel *kernel, double stamp_s);

/* Replace the measured pose_joints by those that are expected once the robot has caught up, fill in
 * their pose, and joint_error: how far the joint that is returned, the farthest, is from its command.
 */
KERNEL_API int32_t kernel_measure(Kernel *kernel);

/* Parts, for the tests that hold them to their oracles. */
KERNEL_API void kernel_kinematics(Kernel *kernel, const double *q, double rotation[9],
                                  double position[3], double *jacobian /* 6 x joints */);
KERNEL_API void kernel_distances(Kernel *kernel, const double *q, double *distances,
                                 double *gradients /* pairs x joints */);
KERNEL_API int32_t kernel_program(Program *program);
KERNEL_API double kernel_smallest_eigenvalue(const double *matrix, int32_t n);

#endif
