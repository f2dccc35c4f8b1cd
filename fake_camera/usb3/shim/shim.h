/* A USB bus for libusb without a kernel: what its files share. Calls go only down this list.
 *
 * Preloaded, this library answers the calls by which libusb's Linux backend finds and drives devices, and passes all
 * others on. Behind each camera is a USB/IP server on a Unix socket; FAKE_CAMERA_USB3 lists them, separated by colons.
 *
 *   interpose.c  replaces the C library's open, close, ioctl and statfs
 *   udev.c       replaces libudev's enumeration and monitor
 *   handle.c     file descriptors of open cameras, and the usbfs calls on them
 *   bus.c        which cameras are plugged in
 *   link.c       URBs of an open camera
 *   answers.c    what the camera answers
 *   pending.c    the queues of what waits for that
 *   usbip.c      messages of USB/IP
 *   host.c       standard error and the kernel's own calls
 */
#ifndef SHIM_H
#define SHIM_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>
#include <sys/uio.h>

#define PUBLIC __attribute__((visibility("default")))
#define LIST_VARIABLE "FAKE_CAMERA_USB3"
#define BUS_NUMBER 100 /* higher than any real bus number */
#define MAX_CAMERAS 32

/* --- host.c --- */

struct statfs;

void complain(const char *format, ...) __attribute__((format(printf, 1, 2))); /* one sentence on standard error */

/* As in the C library, but never answered by this one. */
int real_open(const char *path, int flags, unsigned mode);
int real_close(int fd);
int real_ioctl(int fd, unsigned long request, void *argument);
int real_statfs(const char *path, struct statfs *buffer);

/* --- usbip.c --- */

struct usbip_submit {
    uint32_t sequence;
    uint8_t endpoint;            /* with its direction bit */
    uint32_t length;
    const unsigned char *setup;  /* eight bytes, or NULL */
    const void *data;            /* of an OUT transfer */
};

enum usbip_kind { USBIP_SUBMITTED, USBIP_UNLINKED, USBIP_CLAIMED };

struct usbip_return {
    enum usbip_kind kind;
    uint32_t sequence;
    int status;
    uint32_t actual_length;
};

/* A server that does not answer while it is asked for the camera and its descriptors, or takes nothing that is sent, for
 * two seconds fails; answers to what is sent below are waited for as long as it takes. */
int usbip_import(const char *path); /* a connected socket, or -1 */
bool usbip_send_submit(int sock, const struct usbip_submit *submit);
bool usbip_send_unlink(int sock, uint32_t sequence, uint32_t unlinked);
bool usbip_send_claim(int sock, uint32_t sequence, uint8_t interface, bool claims);
bool usbip_receive_return(int sock, struct usbip_return *answer); /* false: the server has gone, or talks nonsense */
bool usbip_wait(int sock);                                        /* until it sends something */
bool usbip_receive_some(int sock, void *data, size_t bytes, size_t *got); /* what is there, without waiting */
/* Get a descriptor, on a connection that carries nothing else; its length, or -1. */
long usbip_ask(int sock, uint16_t value, void *data, uint16_t bytes);

/* --- bus.c --- */

struct bus_event {
    int port; /* 1, 2 ... in the order of FAKE_CAMERA_USB3 */
    int device;
    bool arrived;
};

void bus_refresh(void);
int bus_device_at(int port);                    /* its address on the bus, 0 when nothing is plugged in */
int bus_ports(void);
bool bus_next_event(struct bus_event *event);
int bus_monitor_start(void);                    /* a descriptor, readable when there are events; or -1 */
void bus_monitor_stop(void);
int bus_open_attribute(const char *name);       /* "PORT_NAME/ATTRIBUTE"; a descriptor, or -1 and errno */
int bus_connect(int device);                    /* a socket to the camera at that address, or -1 and errno */

/* --- link.c: these return 0, or -1 and errno, as usbfs calls do --- */

struct link;
struct usbdevfs_urb;

struct link *link_open(int sock, int *fd); /* owns the socket, sets libusb's descriptor; or NULL and errno */
void link_close(struct link *link);
int link_submit(struct link *link, struct usbdevfs_urb *urb);
int link_reap(struct link *link, struct usbdevfs_urb **urb);
int link_discard(struct link *link, struct usbdevfs_urb *urb);
int link_claim(struct link *link, uint8_t interface, bool claims);
int link_request(struct link *link, uint8_t recipient, uint8_t request, uint16_t value, uint16_t index);

/* --- handle.c --- */

int handle_open(int device);                    /* what opening /dev/bus/usb/... gives, or -1 and errno */
bool handle_close(int fd);                      /* false: not one of ours */
bool handle_ioctl(int fd, unsigned long request, void *argument, int *result);

#endif
