#include "message.h"

#include <string.h>

/* As in units.py, which says why. */
#define RAD_PER_DEG (3.141592653589793 / 180.0)
#define SNAP (1.5 * 2048.0)
#define MM_PER_M 1000.0

/* Tags of fields 1 to 4 as doubles. */
static const uint8_t FIELD[] = {0x09, 0x11, 0x19, 0x21};

static uint8_t *put_varint(uint8_t *at, uint32_t number)
{
    for (; number >= 0x80; number >>= 7)
        *at++ = (uint8_t)(number | 0x80);
    *at++ = (uint8_t)number;
    return at;
}

static uint8_t *put_double(uint8_t *at, uint8_t tag, double value)
{
    uint64_t bits;
    memcpy(&bits, &value, sizeof bits);
    *at++ = tag;
    for (int i = 0; i < 8; i++)
        *at++ = (uint8_t)(bits >> (8 * i));
    return at;
}

static uint8_t *put_angle(uint8_t *at, double radians)
{
    double degrees = radians / RAD_PER_DEG;
    degrees += SNAP;
    return put_double(at, FIELD[0], degrees - SNAP);
}

/* A part of the message, whose tag is `tag`, with one list of six numbers, whose tag is `list`. */
static uint8_t *start_six(uint8_t *at, uint8_t tag, uint8_t list)
{
    const uint8_t start[] = {tag, 0x38, list, 0x36};
    memcpy(at, start, sizeof start);
    return at + sizeof start;
}

static uint8_t *put_angles(uint8_t *at, uint8_t tag, const double *radians)
{
    at = start_six(at, tag, 0x0a);
    for (int i = 0; i < 6; i++)
        at = put_angle(at, radians[i]);
    return at;
}

uint8_t *egm_put_header(uint8_t *at, uint32_t seqno, uint32_t tm_ms)
{
    *at++ = 0x0a;
    uint8_t *length = at++, *numbers = at;
    *at++ = 0x08;
    at = put_varint(at, seqno);
    *at++ = 0x10;
    at = put_varint(at, tm_ms);
    *at++ = 0x18;
    *at++ = 0x03; /* a correction */
    *length = (uint8_t)(at - numbers);
    return at;
}

uint8_t *egm_put_joints(uint8_t *at, const double *radians)
{
    return put_angles(at, 0x12, radians);
}

uint8_t *egm_put_joint_speeds(uint8_t *at, const double *radians_per_s)
{
    return put_angles(at, 0x1a, radians_per_s);
}

uint8_t *egm_put_pose(uint8_t *at, const double *position_m, const double *quaternion)
{
    static const uint8_t START[] = {0x12, 0x45, 0x12, 0x43, 0x0a, 0x1b}, TURN[] = {0x12, 0x24};
    memcpy(at, START, sizeof START);
    at += sizeof START;
    for (int i = 0; i < 3; i++)
        at = put_double(at, FIELD[i], position_m[i] * MM_PER_M);
    memcpy(at, TURN, sizeof TURN);
    at += sizeof TURN;
    for (int i = 0; i < 4; i++)
        at = put_double(at, FIELD[i], quaternion[i]);
    return at;
}

uint8_t *egm_put_twist(uint8_t *at, const double *linear_m_s, const double *angular_rad_s)
{
    at = start_six(at, 0x1a, 0x12);
    for (int i = 0; i < 3; i++)
        at = put_double(at, FIELD[0], linear_m_s[i] * MM_PER_M);
    for (int i = 0; i < 3; i++)
        at = put_angle(at, angular_rad_s[i]);
    return at;
}
