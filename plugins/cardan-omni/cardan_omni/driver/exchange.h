/* Triple buffer between one writer and one reader: which of three buffers each side has, and which
 * lies between them. Neither side waits. */
#ifndef CARDAN_OMNI_EXCHANGE_H
#define CARDAN_OMNI_EXCHANGE_H

#include <stdatomic.h>
#include <stdbool.h>

#define EXCHANGE_FRESH 4u

typedef struct {
    _Atomic unsigned middle; /* index | EXCHANGE_FRESH: not read yet */
    unsigned writer;
    unsigned reader;
} Exchange;

static inline void exchange_reset(Exchange *exchange)
{
    exchange->writer = 0;
    atomic_store(&exchange->middle, 1u);
    exchange->reader = 2;
}

/* Hands over what the writer has filled. */
static inline void exchange_give(Exchange *exchange)
{
    unsigned old = atomic_exchange_explicit(&exchange->middle, exchange->writer | EXCHANGE_FRESH,
                                            memory_order_acq_rel);
    exchange->writer = old & 3u;
}

/* True if the reader has had what was given last. */
static inline bool exchange_was_taken(Exchange *exchange)
{
    return !(atomic_load_explicit(&exchange->middle, memory_order_relaxed) & EXCHANGE_FRESH);
}

/* True if there is something new, which the reader then has. */
static inline bool exchange_take(Exchange *exchange)
{
    if (!(atomic_load_explicit(&exchange->middle, memory_order_relaxed) & EXCHANGE_FRESH))
        return false;
    exchange->reader = atomic_exchange_explicit(&exchange->middle, exchange->reader,
                                                memory_order_acq_rel) & 3u;
    return true;
}

#endif
