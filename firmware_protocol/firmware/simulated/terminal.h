/* SPDX-License-Identifier: MIT */
/* A pseudo-terminal for an emulated board: a port that any program opens like a serial device's. Linux. */
#ifndef TERMINAL_H
#define TERMINAL_H

/* The near end, not blocking, or -1. The far end's path goes to `path`. Both ends are raw before anybody can open them,
 * and a descriptor of the far end stays open: else the first bytes would be echoed, and every close of the host would
 * read as a hang-up. */
int open_terminal(char *path, int room);

#endif
