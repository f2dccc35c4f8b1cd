/* The C library's functions by which libusb reaches devices: calls for our cameras are answered, others passed on. */
#define _GNU_SOURCE
#include "shim.h"

#include <fcntl.h>
#include <linux/magic.h>
#include <stdarg.h>
#include <stdio.h>
#include <string.h>
#include <sys/vfs.h>

#define ATTRIBUTES "/sys/bus/usb/devices/"
#define NODES "/dev/bus/usb/"

static bool begins(const char *text, const char *beginning)
{
    return strncmp(text, beginning, strlen(beginning)) == 0;
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

/* What open becomes in libraries built with _FORTIFY_SOURCE. */
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
    return real_ioctl(fd, request, argument);
}

/* libusb asks whether sysfs is there, which a container may lack. */
PUBLIC int statfs(const char *path, struct statfs *buffer)
{
    int result = real_statfs(path, buffer);
    if (strcmp(path, "/sys") == 0) {
        if (result != 0)
            memset(buffer, 0, sizeof *buffer);
        buffer->f_type = SYSFS_MAGIC;
        return 0;
    }
    return result;
}
