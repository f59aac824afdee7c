// Pseudo-terminals: what is under way on them, and the calls by which Python uses them.
#pragma once
#include <pty.h>
#include <sys/ioctl.h>
#include <sys/types.h>
#include <termios.h>

namespace simulated_time {
bool wires_are_quiet();
void forget_terminals();

ssize_t write_(int fd, const void* bytes, size_t count);
ssize_t read_(int fd, void* bytes, size_t count);
int tcflush_(int fd, int which);
int openpty_(int* ours, int* theirs, char* name, const termios* state, const winsize* size);
}  // namespace simulated_time
