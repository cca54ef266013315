#include "read.h"

#include <math.h>
#include <stdbool.h>
#include <string.h>

#define RAD_PER_DEG (3.141592653589793 / 180.0)
#define MM_PER_M 1000.0
#define VARINT_MAX 5
#define FIRST_DOUBLE 2
#define DOUBLES 13

static bool is_sound(const EgmLayout *layout)
{
    int count = EGM_VALUES + layout->forces + (layout->has_rate != 0);
    if (layout->length > EGM_LENGTH_MAX || layout->forces < 0 || layout->forces > EGM_FORCES)
        return false;
    for (int i = 0; i < count; i++) {
        bool whole = i >= FIRST_DOUBLE && (i < FIRST_DOUBLE + DOUBLES || i >= EGM_VALUES);
        int size = layout->size[i];
        if (size < 1 || size > (whole ? 8 : VARINT_MAX) || (whole && size != 8) ||
            layout->place[i] < 0 || layout->place[i] > layout->length - size)
            return false;
    }
    return true;
}

static bool fits(const EgmLayout *layout, const uint8_t *data)
{
    uint64_t differs = 0, word, fixed, mask;
    int at = 0;
    for (; at + (int)sizeof word <= layout->length; at += (int)sizeof word) {
        memcpy(&word, data + at, sizeof word);
        memcpy(&fixed, layout->fixed + at, sizeof fixed);
        memcpy(&mask, layout->mask + at, sizeof mask);
        differs |= (word ^ fixed) & mask;
    }
    for (; at < layout->length; at++)
        differs |= (uint64_t)((data[at] ^ layout->fixed[at]) & layout->mask[at]);
    return !differs;
}

static uint64_t varint(const EgmLayout *layout, const uint8_t *data, int value)
{
    uint64_t number = 0;
    for (int i = 0; i < layout->size[value]; i++)
        number |= (uint64_t)(data[layout->place[value] + i] & 0x7f) << (7 * i);
    return number;
}

static double number(const EgmLayout *layout, const uint8_t *data, int value)
{
    uint64_t bits = 0;
    double found;
    for (int i = 0; i < 8; i++)
        bits |= (uint64_t)data[layout->place[value] + i] << (8 * i);
    memcpy(&found, &bits, sizeof found);
    return found;
}

static bool read_with(EgmReader *reader, const EgmLayout *layout, const uint8_t *data)
{
    double found[DOUBLES], sum = 0.0, later = 0.0;
    for (int i = 0; i < DOUBLES; i++)
        sum += found[i] = number(layout, data, FIRST_DOUBLE + i);
    for (int i = 0; i < layout->forces; i++)
        later += reader->forces[i] = number(layout, data, EGM_VALUES + i);
    if (layout->has_rate)
        later += reader->rate = number(layout, data, EGM_VALUES + layout->forces);
    if (!isfinite(sum + later))
        return false;
    for (int i = 0; i < 6; i++)
        reader->joints[i] = found[i] * RAD_PER_DEG;
    for (int i = 0; i < 3; i++)
        reader->position[i] = found[6 + i] / MM_PER_M;
    for (int i = 0; i < 4; i++)
        reader->orientation[i] = found[9 + i];
    reader->seqno = (uint32_t)varint(layout, data, 0);
    reader->tm_ms = (uint32_t)varint(layout, data, 1);
    reader->time_us = (int64_t)(1000000u * varint(layout, data, FIRST_DOUBLE + DOUBLES) +
                                varint(layout, data, FIRST_DOUBLE + DOUBLES + 1));
    return true;
}

int32_t egm_read(EgmReader *reader, const uint8_t *data, int64_t length)
{
    /* Most datagrams are as long as the one before: no others are looked at. */
    uint32_t first = (uint32_t)reader->newest % EGM_LAYOUTS;
    for (uint32_t i = 0; i < EGM_LAYOUTS && length > 0; i++) {
        uint32_t index = (first + i) % EGM_LAYOUTS;
        const EgmLayout *layout = &reader->layouts[index];
        if (layout->length != length)
            continue;
        reader->newest = (int32_t)index;
        bool good = is_sound(layout) && fits(layout, data) && read_with(reader, layout, data);
        return good ? (int32_t)index : -1;
    }
    return -1;
}
