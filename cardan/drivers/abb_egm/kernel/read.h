/*
 * A controller's feedback, read by a layout that was learned from a datagram before:
 * cardan/protocols/egm/reader.py's FeedbackReader, to the last bit. What a layout is, it says.
 *
 * cardan/drivers/abb_egm/compiled.py mirrors the structures, and owns their memory.
 */
#ifndef CARDAN_EGM_READ_H
#define CARDAN_EGM_READ_H

#include "message.h"

#define EGM_LAYOUTS 16
#define EGM_LENGTH_MAX 512

/* Places of the values that every datagram with a layout has, in the order of EgmReader's fields:
 * seqno, tm, 6 joints, 3 of the position, 4 of the orientation, sec, usec. */
#define EGM_VALUES 17
#define EGM_FORCES 6

typedef struct {
    int32_t length; /* of the datagram; 0: there is no layout here */
    int32_t forces, has_rate;
    int32_t states[3]; /* motors, MCI, RAPID */
    int32_t place[EGM_VALUES + EGM_FORCES + 1], size[EGM_VALUES + EGM_FORCES + 1]; /* bytes */
    uint8_t mask[EGM_LENGTH_MAX], fixed[EGM_LENGTH_MAX];
} EgmLayout;

typedef struct {
    double joints[6];      /* rad */
    double position[3];    /* m */
    double orientation[4]; /* as it came */
    double rate;           /* where the layout has it */
    double forces[EGM_FORCES];
    int64_t time_us;
    uint32_t seqno, tm_ms;
    int32_t newest; /* layout */
    EgmLayout layouts[EGM_LAYOUTS];
} EgmReader;

/* Read a datagram; the layout that it has. -1 where it has none of them, where a number is none, and
 * where a layout is not sound. */
EGM_API int32_t egm_read(EgmReader *reader, const uint8_t *data, int64_t length);

#endif
