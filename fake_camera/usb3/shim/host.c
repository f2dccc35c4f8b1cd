/* What lies outside the fake bus: standard error, and the kernel's own calls past the functions of interpose.c. */
#define _GNU_SOURCE
#include "shim.h"

#include <fcntl.h>
#include <stdarg.h>
#include <stdio.h>
#include <sys/syscall.h>
#include <unistd.h>

void complain(const char *format, ...)
{
    va_list arguments;
    char sentence[512];
    va_start(arguments, format);
    vsnprintf(sentence, sizeof sentence, format, arguments);
    va_end(arguments);
    fprintf(stderr, "fake USB bus: %s\n", sentence);
}

int real_open(const char *path, int flags, unsigned mode)
{
    return (int)syscall(SYS_openat, AT_FDCWD, path, flags, mode);
}

int real_close(int fd)
{
    return (int)syscall(SYS_close, fd);
}

int real_ioctl(int fd, unsigned long request, void *argument)
{
    return (int)syscall(SYS_ioctl, fd, request, argument);
}

int real_statfs(const char *path, struct statfs *buffer)
{
    return (int)syscall(SYS_statfs, path, buffer);
}
