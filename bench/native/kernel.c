/*
 * Cardan's own kernel, timed like the others: its library is already loaded, its goal is in its
 * memory, and this function calls its tick.
 */
#include "peer.h"

typedef double (*Tick)(void *kernel, double dt, int32_t flags);

PEER_API double kernel_step(Tick tick, void *kernel, double dt);

double kernel_step(Tick tick, void *kernel, double dt)
{
    const double begin = peer_now();
    tick(kernel, dt, 0);
    return peer_now() - begin;
}
