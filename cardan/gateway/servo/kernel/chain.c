#include "chain.h"

#include <string.h>

#include "vectors.h"

void chain_set_joint(Chain *chain, int index, const Placement *placement, const double axis[3],
                     int prismatic)
{
    const double *r = placement->rotation;
    const double k[9] = {0.0, -axis[2], axis[1], axis[2], 0.0, -axis[0], -axis[1], axis[0], 0.0};
    double k2[9];
    multiply33(k, k, k2);
    memcpy(chain->fixed[index], r, sizeof chain->fixed[index]);
    multiply33(r, k, chain->sine[index]);
    multiply33(r, k2, chain->versine[index]);
    copy3(placement->position, chain->offset[index]);
    turn3(r, axis, chain->axis[index]);
    chain->prismatic[index] = prismatic;
}

void chain_update(const Chain *chain, const double *q, ChainPose *pose)
{
    for (int i = 0; i < chain->joints; i++) {
        const Placement *before = &pose->bodies[i];
        Placement *body = &pose->bodies[i + 1];
        double moved[3], turned[9];
        turn3(before->rotation, chain->offset[i], moved);
        along3(before->position, 1.0, moved, pose->origins[i]);
        turn3(before->rotation, chain->axis[i], pose->axes[i]);
        if (chain->prismatic[i]) {
            along3(pose->origins[i], q[i], pose->axes[i], body->position);
            multiply33(before->rotation, chain->fixed[i], body->rotation);
            continue;
        }
        double s = sin(q[i]), half = sin(0.5 * q[i]), versine = 2.0 * half * half;
        for (int e = 0; e < 9; e++)
            turned[e] = chain->fixed[i][e] + s * chain->sine[i][e] + versine * chain->versine[i][e];
        copy3(pose->origins[i], body->position);
        multiply33(before->rotation, turned, body->rotation);
    }
    const Placement *last = &pose->bodies[chain->joints];
    double moved[3];
    turn3(last->rotation, chain->tool.position, moved);
    along3(last->position, 1.0, moved, pose->tcp.position);
    multiply33(last->rotation, chain->tool.rotation, pose->tcp.rotation);
}

void chain_jacobian(const Chain *chain, const ChainPose *pose, double jacobian[6][MAX_JOINTS])
{
    for (int i = 0; i < chain->joints; i++) {
        double linear[3], angular[3] = {0.0, 0.0, 0.0}, arm[3], lever[3];
        if (chain->prismatic[i]) {
            turn_back3(pose->tcp.rotation, pose->axes[i], linear);
        } else {
            subtract3(pose->tcp.position, pose->origins[i], arm);
            cross3(pose->axes[i], arm, lever);
            turn_back3(pose->tcp.rotation, lever, linear);
            turn_back3(pose->tcp.rotation, pose->axes[i], angular);
        }
        for (int row = 0; row < 3; row++) {
            jacobian[row][i] = linear[row];
            jacobian[3 + row][i] = angular[row];
        }
    }
}

void rotation_to_quaternion(const double r[9], double q[4])
{
    /* The largest of the four is divided by: Shepperd 1978. */
    double trace = r[0] + r[4] + r[8];
    int largest = 0;
    if (r[4] > r[0])
        largest = 1;
    if (r[8] > r[4 * largest])
        largest = 2;
    if (trace > r[4 * largest]) {
        double root = sqrt(1.0 + trace), share = 0.5 / root;
        q[0] = 0.5 * root;
        q[1] = (r[7] - r[5]) * share;
        q[2] = (r[2] - r[6]) * share;
        q[3] = (r[3] - r[1]) * share;
    } else {
        int i = largest, j = (i + 1) % 3, k = (j + 1) % 3;
        double square = 1.0 + r[4 * i] - r[4 * j] - r[4 * k];
        double root = sqrt(square > 0.0 ? square : 0.0), share = root > 0.0 ? 0.5 / root : 0.0;
        q[1 + i] = 0.5 * root;
        q[0] = (r[3 * k + j] - r[3 * j + k]) * share;
        q[1 + j] = (r[3 * j + i] + r[3 * i + j]) * share;
        q[1 + k] = (r[3 * k + i] + r[3 * i + k]) * share;
    }
    if (q[0] < 0.0)
        for (int i = 0; i < 4; i++)
            q[i] = -q[i];
}

void quaternion_to_rotation(const double quaternion[4], double r[9])
{
    double w = quaternion[0], x = quaternion[1], y = quaternion[2], z = quaternion[3];
    double length = sqrt(w * w + x * x + y * y + z * z);
    w /= length;
    x /= length;
    y /= length;
    z /= length;
    r[0] = 1.0 - 2.0 * (y * y + z * z);
    r[1] = 2.0 * (x * y - w * z);
    r[2] = 2.0 * (x * z + w * y);
    r[3] = 2.0 * (x * y + w * z);
    r[4] = 1.0 - 2.0 * (x * x + z * z);
    r[5] = 2.0 * (y * z - w * x);
    r[6] = 2.0 * (x * z - w * y);
    r[7] = 2.0 * (y * z + w * x);
    r[8] = 1.0 - 2.0 * (x * x + y * y);
}

void rotation_log(const double rotation[9], double vector[3])
{
    double q[4];
    rotation_to_quaternion(rotation, q);
    double sine = norm3(q + 1);
    /* Below, the angle is twice the vector to the last bit. */
    double gain = sine > 1e-9 ? 2.0 * atan2(sine, q[0]) / sine : 2.0;
    for (int i = 0; i < 3; i++)
        vector[i] = gain * q[1 + i];
}

void rotation_exp(const double vector[3], double rotation[9])
{
    double angle = norm3(vector);
    double share = angle > 1e-9 ? sin(0.5 * angle) / angle : 0.5;
    const double q[4] = {cos(0.5 * angle), share * vector[0], share * vector[1],
                         share * vector[2]};
    quaternion_to_rotation(q, rotation);
}
