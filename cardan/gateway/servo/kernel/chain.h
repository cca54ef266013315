/* Kinematics of a serial chain with a tool fixed to its last body. */
#ifndef CARDAN_SERVO_CHAIN_H
#define CARDAN_SERVO_CHAIN_H

#define MAX_JOINTS 9

typedef struct {
    double rotation[9];
    double position[3];
} Placement;

typedef struct {
    int joints;
    int prismatic[MAX_JOINTS];
    /* Rotation from the body before to the body that the joint moves: fixed + sin q * sine +
     * (1 - cos q) * versine; of a prismatic joint only the first is used. */
    double fixed[MAX_JOINTS][9], sine[MAX_JOINTS][9], versine[MAX_JOINTS][9];
    double offset[MAX_JOINTS][3]; /* of the joint in the body before */
    double axis[MAX_JOINTS][3];   /* unit vector, in the body before */
    Placement tool;               /* TCP in the last body */
} Chain;

typedef struct {
    Placement bodies[MAX_JOINTS + 1]; /* body 0 is the base */
    Placement tcp;
    double axes[MAX_JOINTS][3];    /* of the joints, base axes */
    double origins[MAX_JOINTS][3]; /* of the joints, base */
} ChainPose;

/* Set joint `index`: its placement in the body before and its unit axis in its own frame. */
void chain_set_joint(Chain *chain, int index, const Placement *placement, const double axis[3],
                     int prismatic);

void chain_update(const Chain *chain, const double *q, ChainPose *pose);

/* Twist of the TCP in its own axes per joint speed; linear part first, a column a joint. */
void chain_jacobian(const Chain *chain, const ChainPose *pose, double jacobian[6][MAX_JOINTS]);

/* w x y z, w >= 0, of a rotation. */
void rotation_to_quaternion(const double rotation[9], double quaternion[4]);

/* The rotation of a quaternion w x y z of any length above 0. */
void quaternion_to_rotation(const double quaternion[4], double rotation[9]);

/* Axis times angle of a rotation, angle 0 to pi, and the rotation of such a vector. */
void rotation_log(const double rotation[9], double vector[3]);
void rotation_exp(const double vector[3], double rotation[9]);

#endif
