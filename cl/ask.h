// Memory that is asked for early.
#ifndef CLG_ASK_H
#define CLG_ASK_H
#include "config.h"

// Asks for a cache line before it is needed.
void ask_for(__global const void *at)
{
#if defined(__has_builtin)
#if __has_builtin(__builtin_prefetch)
    __builtin_prefetch((const void *)(size_t)at, 0, 3);
#endif
#endif
}

#endif
