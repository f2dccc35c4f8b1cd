/* File descriptors of open cameras, as if of /dev/bus/usb/BUS/DEVICE, and the usbfs calls on them. */
#define _GNU_SOURCE
#include "shim.h"

#include <errno.h>
#include <linux/usbdevice_fs.h>
#include <stdatomic.h>
#include <sys/ioctl.h>

enum { MAX_DESCRIPTORS = 4096 };
enum { CLEAR_FEATURE = 1, SET_CONFIGURATION = 9, SET_INTERFACE = 11, TO_DEVICE = 0, TO_INTERFACE = 1, TO_ENDPOINT = 2 };

static _Atomic(struct link *) links[MAX_DESCRIPTORS];

static int control(struct link *link, unsigned long what, void *argument)
{
    switch (what) {
    case USBDEVFS_SUBMITURB:
        return link_submit(link, argument);
    case USBDEVFS_REAPURBNDELAY:
        return link_reap(link, argument);
    case USBDEVFS_DISCARDURB:
        return link_discard(link, argument);
    case USBDEVFS_GET_CAPABILITIES: /* with scatter-gather each transfer is one URB */
        *(uint32_t *)argument = USBDEVFS_CAP_BULK_SCATTER_GATHER | USBDEVFS_CAP_REAP_AFTER_DISCONNECT;
        return 0;
    case USBDEVFS_CLAIMINTERFACE:
        return link_claim(link, *(unsigned *)argument & 0xFF, true);
    case USBDEVFS_RELEASEINTERFACE:
        return link_claim(link, *(unsigned *)argument & 0xFF, false);
    case USBDEVFS_DISCONNECT_CLAIM:
        return link_claim(link, ((struct usbdevfs_disconnect_claim *)argument)->interface & 0xFF, true);
    case USBDEVFS_CLEAR_HALT:
        return link_request(link, TO_ENDPOINT, CLEAR_FEATURE, 0, *(unsigned *)argument);
    case USBDEVFS_SETCONFIGURATION:
        return link_request(link, TO_DEVICE, SET_CONFIGURATION, *(unsigned *)argument, 0);
    case USBDEVFS_SETINTERFACE: {
        struct usbdevfs_setinterface *set = argument;
        return link_request(link, TO_INTERFACE, SET_INTERFACE, set->altsetting, set->interface);
    }
    case USBDEVFS_GETDRIVER: /* no kernel driver is bound to the camera */
    case USBDEVFS_IOCTL:
        errno = ENODATA;
        return -1;
    default:
        complain("libusb needs the usbfs call %#lx, which is missing: add it to handle.c", what);
        errno = ENOTTY;
        return -1;
    }
}

static struct link *link_of(int fd)
{
    return fd >= 0 && fd < MAX_DESCRIPTORS ? atomic_load(&links[fd]) : NULL;
}

bool handle_ioctl(int fd, unsigned long what, void *argument, int *result)
{
    struct link *link = link_of(fd);
    if (link)
        *result = control(link, what, argument);
    return link != NULL;
}

int handle_open(int device)
{
    int fd, sock = bus_connect(device);
    if (sock < 0)
        return -1;
    struct link *link = link_open(sock, &fd);
    if (!link)
        real_close(sock);
    else if (fd >= MAX_DESCRIPTORS) {
        link_close(link);
        link = NULL;
    }
    if (!link) {
        errno = EMFILE;
        return -1;
    }
    atomic_store(&links[fd], link);
    return fd;
}

bool handle_close(int fd)
{
    struct link *link = link_of(fd);
    if (!link)
        return false;
    atomic_store(&links[fd], NULL);
    link_close(link);
    return true;
}
