/* The C library's calls by which libusb reaches devices: those to our cameras are answered, the others passed on. */
#define _GNU_SOURCE
#include "shim.h"

#include <dlfcn.h>
#include <errno.h>
#include <fcntl.h>
#include <linux/magic.h>
#include <stdarg.h>
#include <stdio.h>
#include <string.h>
#include <sys/stat.h>
#include <sys/syscall.h>
#include <sys/vfs.h>
#include <unistd.h>

#define ATTRIBUTES "/sys/bus/usb/devices/"
#define NODES "/dev/bus/usb/"

void complain(const char *format, ...)
{
    va_list arguments;
    char sentence[512];
    va_start(arguments, format);
    vsnprintf(sentence, sizeof sentence, format, arguments);
    va_end(arguments);
    fprintf(stderr, "fake USB bus: %s\n", sentence);
}

static bool begins(const char *text, const char *beginning)
{
    return strncmp(text, beginning, strlen(beginning)) == 0;
}

int real_open(const char *path, int flags, unsigned mode)
{
    return (int)syscall(SYS_openat, AT_FDCWD, path, flags, mode);
}

int real_close(int fd)
{
    return (int)syscall(SYS_close, fd);
}

static int open_node(const char *path, int flags, unsigned mode)
{
    int bus, device;
    if (sscanf(path, NODES "%d/%d", &bus, &device) == 2 && bus == BUS_NUMBER)
        return handle_open(device);
    return real_open(path, flags, mode);
}

static int open_any(const char *path, int flags, unsigned mode)
{
    if (begins(path, NODES))
        return open_node(path, flags, mode);
    if (begins(path, ATTRIBUTES)) {
        int fd = bus_open_attribute(path + strlen(ATTRIBUTES));
        if (fd >= 0)
            return fd;
    }
    return real_open(path, flags, mode);
}

static unsigned mode_of(int flags, va_list arguments)
{
    return flags & O_CREAT || (flags & O_TMPFILE) == O_TMPFILE ? va_arg(arguments, unsigned) : 0;
}

PUBLIC int open(const char *path, int flags, ...)
{
    va_list arguments;
    va_start(arguments, flags);
    unsigned mode = mode_of(flags, arguments);
    va_end(arguments);
    return open_any(path, flags, mode);
}

PUBLIC int open64(const char *path, int flags, ...)
{
    va_list arguments;
    va_start(arguments, flags);
    unsigned mode = mode_of(flags, arguments);
    va_end(arguments);
    return open_any(path, flags | O_LARGEFILE, mode);
}

/* What open becomes in libraries that were built with _FORTIFY_SOURCE. */
PUBLIC int __open_2(const char *path, int flags)
{
    return open_any(path, flags, 0);
}

PUBLIC int __open64_2(const char *path, int flags)
{
    return open_any(path, flags | O_LARGEFILE, 0);
}

PUBLIC int close(int fd)
{
    return handle_close(fd) ? 0 : real_close(fd);
}

PUBLIC int ioctl(int fd, unsigned long request, ...)
{
    va_list arguments;
    va_start(arguments, request);
    void *argument = va_arg(arguments, void *);
    va_end(arguments);
    int result;
    if (handle_ioctl(fd, request, argument, &result))
        return result;
    return (int)syscall(SYS_ioctl, fd, request, argument);
}

/* libusb asks whether sysfs is there, which a container may lack. */
PUBLIC int statfs(const char *path, struct statfs *buffer)
{
    int result = (int)syscall(SYS_statfs, path, buffer);
    if (strcmp(path, "/sys") == 0) {
        if (result != 0)
            memset(buffer, 0, sizeof *buffer);
        buffer->f_type = SYSFS_MAGIC;
        return 0;
    }
    return result;
}
