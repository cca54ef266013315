/*
 * The messages that answer a controller: cardan/protocols/egm/replies.py, and those of encode.py that
 * have a speed reference alone, byte for byte.
 */
#ifndef CARDAN_EGM_MESSAGE_H
#define CARDAN_EGM_MESSAGE_H

#include <stddef.h>
#include <stdint.h>

#if defined(__GNUC__)
#define EGM_API __attribute__((visibility("default")))
#else
#define EGM_API
#endif

/* Header 18, a pose 71, its speed 58. */
#define EGM_REPLY_MAX 160

/* What answers say. */
#define EGM_SAYS_POSITION 1
#define EGM_SAYS_SPEED 2

/* Each writes at `at` and returns where it ended. */
uint8_t *egm_put_header(uint8_t *at, uint32_t seqno, uint32_t tm_ms);
uint8_t *egm_put_joints(uint8_t *at, const double *radians);
uint8_t *egm_put_joint_speeds(uint8_t *at, const double *radians_per_s);
uint8_t *egm_put_pose(uint8_t *at, const double *position_m, const double *quaternion);
uint8_t *egm_put_twist(uint8_t *at, const double *linear_m_s, const double *angular_rad_s);

#endif
