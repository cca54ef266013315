/*
 * Cardan's own kernel, timed as the others are: its library is loaded already, its goal is in its
 * memory, and this calls its tick.
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
