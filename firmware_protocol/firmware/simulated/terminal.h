/* SPDX-License-Identifier: MIT */
/* A pseudo-terminal for an emulated board: a port that any program opens like a serial device's. Linux only. */
#ifndef TERMINAL_H
#define TERMINAL_H

/* Opens a pseudo-terminal. Returns its near end, not blocking, or -1. Writes the far end's path to `path`. Both ends
 * are raw before anybody can open them, else the first bytes would be echoed. A descriptor of the far end stays open,
 * else every close by the host would read as a hang-up. */
int open_terminal(char *path, int room);

#endif
