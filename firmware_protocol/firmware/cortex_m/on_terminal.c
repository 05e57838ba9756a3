/* SPDX-License-Identifier: MIT */
/* Starts a program with its standard input and output on a pseudo-terminal: `on_terminal PROGRAM WORD...`. Before that,
 * it prints the terminal's path on its own standard output. */
#define _GNU_SOURCE
#include "terminal.h"

#include <stdio.h>
#include <unistd.h>

int main(int count, char **words) {
    char path[64];
    const int port = count > 1 ? open_terminal(path, sizeof path) : -1;
    if (port < 0) {
        fprintf(stderr, "usage: on_terminal PROGRAM WORD...; or no pseudo-terminal is to be had\n");
        return 3;
    }
    printf("%s\n", path);
    fflush(stdout);
    dup2(port, 0);
    dup2(port, 1);
    execvp(words[1], words + 1);
    perror(words[1]);
    return 3;
}
