/* Which cameras are plugged in. Each has a connection: while that is open, the camera is plugged in. */
#define _GNU_SOURCE
#include "shim.h"

#include <errno.h>
#include <fcntl.h>
#include <poll.h>
#include <pthread.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/mman.h>
#include <sys/socket.h>
#include <unistd.h>

enum { MAX_EVENTS = 64, LOOK_EVERY_MS = 100, MAX_DESCRIPTOR_BYTES = 1024 };
enum { DEVICE_DESCRIPTOR = 0x0100, CONFIGURATION_DESCRIPTOR = 0x0200, STRING_DESCRIPTOR = 0x0300 };
enum { DEVICE_DESCRIPTOR_BYTES = 18, FIRST_STRING_INDEX = 14, STRINGS = 3, MAX_STRING_BYTES = 255 };

static const char *const string_names[STRINGS] = {"manufacturer", "product", "serial"};

struct camera {
    char *path;
    int connection;
    int device; /* 0: nothing is plugged in */
    size_t descriptor_bytes;
    unsigned char descriptors[MAX_DESCRIPTOR_BYTES];
    char strings[STRINGS][MAX_STRING_BYTES / 2 + 2]; /* as in sysfs, with a line feed */
};

static pthread_once_t once = PTHREAD_ONCE_INIT;
static pthread_mutex_t lock = PTHREAD_MUTEX_INITIALIZER; /* guards all below */
static struct camera cameras[MAX_CAMERAS];
static int ports;
static int last_device = 1; /* a root hub would have this address */
static struct bus_event events[MAX_EVENTS];
static unsigned first_event, next_event;

static pthread_t monitor;
static bool monitoring;
static int event_pipe[2] = {-1, -1}; /* holds a byte for each event */
static int stop_pipe[2] = {-1, -1};

static void read_list(void)
{
    const char *list = getenv(LIST_VARIABLE);
    if (!list || !*list) {
        complain(LIST_VARIABLE " is not set, so no camera is on the bus: list the cameras' sockets in it");
        return;
    }
    char *copy = strdup(list), *rest = copy;
    for (char *path; copy && (path = strsep(&rest, ":"));) {
        if (ports == MAX_CAMERAS) {
            complain(LIST_VARIABLE " lists more than %d cameras: those after %s are left out", MAX_CAMERAS,
                     cameras[ports - 1].path);
            break;
        }
        if (*path)
            cameras[ports++].path = strdup(path);
    }
    free(copy);
}

static void add_event(int port, bool arrived)
{
    if (next_event - first_event == MAX_EVENTS) {
        complain("the program has left %d USB events unread: one is dropped", MAX_EVENTS);
        return;
    }
    events[next_event++ % MAX_EVENTS] = (struct bus_event){port, cameras[port - 1].device, arrived};
    if (event_pipe[1] >= 0 && write(event_pipe[1], "", 1) < 0)
        complain("cannot signal a USB event: %s", strerror(errno));
}

static void read_strings(struct camera *camera)
{
    for (int i = 0; i < STRINGS; i++) {
        unsigned char utf16[MAX_STRING_BYTES] = "";
        char *text = camera->strings[i];
        uint16_t index = camera->descriptors[FIRST_STRING_INDEX + i];
        long bytes = usbip_ask(camera->connection, STRING_DESCRIPTOR | index, utf16, sizeof utf16);
        for (long at = 2; at + 1 < bytes; at += 2)
            *text++ = utf16[at + 1] ? '?' : (char)utf16[at];
        strcpy(text, "\n");
    }
}

static bool read_descriptors(struct camera *camera)
{
    unsigned char *device = camera->descriptors, *configuration = device + DEVICE_DESCRIPTOR_BYTES;
    uint16_t room = MAX_DESCRIPTOR_BYTES - DEVICE_DESCRIPTOR_BYTES;
    if (usbip_ask(camera->connection, DEVICE_DESCRIPTOR, device, DEVICE_DESCRIPTOR_BYTES) != DEVICE_DESCRIPTOR_BYTES)
        return false;
    long bytes = usbip_ask(camera->connection, CONFIGURATION_DESCRIPTOR, configuration, room);
    if (bytes <= 0)
        return false;
    camera->descriptor_bytes = DEVICE_DESCRIPTOR_BYTES + (size_t)bytes;
    read_strings(camera);
    return true;
}

static void look_at(int port)
{
    struct camera *camera = &cameras[port - 1];
    char byte;
    if (camera->device && (recv(camera->connection, &byte, 1, MSG_PEEK | MSG_DONTWAIT) >= 0 || errno != EAGAIN)) {
        add_event(port, false);
        real_close(camera->connection);
        camera->device = 0;
    }
    if (!camera->device && (camera->connection = usbip_import(camera->path)) >= 0) {
        if (read_descriptors(camera)) {
            camera->device = last_device = last_device % 127 + 1; /* a new address each time, as Linux gives them */
            add_event(port, true);
        } else
            real_close(camera->connection);
    }
}

void bus_refresh(void)
{
    pthread_once(&once, read_list);
    pthread_mutex_lock(&lock);
    for (int port = 1; port <= ports; port++)
        look_at(port);
    pthread_mutex_unlock(&lock);
}

int bus_ports(void)
{
    return ports;
}

int bus_device_at(int port)
{
    pthread_mutex_lock(&lock);
    int device = port >= 1 && port <= ports ? cameras[port - 1].device : 0;
    pthread_mutex_unlock(&lock);
    return device;
}

bool bus_next_event(struct bus_event *event)
{
    pthread_mutex_lock(&lock);
    bool any = first_event != next_event;
    if (any) {
        char byte;
        *event = events[first_event++ % MAX_EVENTS];
        if (event_pipe[0] >= 0 && read(event_pipe[0], &byte, 1) < 0 && errno != EAGAIN)
            complain("cannot read the pipe of USB events: %s", strerror(errno));
    }
    pthread_mutex_unlock(&lock);
    return any;
}

/* Wait until a camera goes or it is time to look for new ones; false: the monitor is to stop. */
static bool wait_for_change(void)
{
    struct pollfd watched[MAX_CAMERAS + 1] = {{.fd = stop_pipe[0], .events = POLLIN}};
    nfds_t count = 1;
    pthread_mutex_lock(&lock);
    for (int i = 0; i < ports; i++)
        if (cameras[i].device)
            watched[count++] = (struct pollfd){.fd = cameras[i].connection, .events = POLLIN};
    bool all_there = count == (nfds_t)ports + 1;
    pthread_mutex_unlock(&lock);
    poll(watched, count, all_there ? -1 : LOOK_EVERY_MS);
    return !watched[0].revents;
}

static void *watch(void *unused)
{
    (void)unused;
    while (wait_for_change())
        bus_refresh();
    return NULL;
}

static void close_pipe(int ends[2])
{
    for (int end = 0; end < 2; end++) {
        if (ends[end] >= 0)
            real_close(ends[end]);
        ends[end] = -1;
    }
}

int bus_monitor_start(void)
{
    if (monitoring) {
        complain("a second udev monitor in one process is not supported");
        return -1;
    }
    if (pipe2(event_pipe, O_CLOEXEC | O_NONBLOCK) == 0 && pipe2(stop_pipe, O_CLOEXEC) == 0) {
        bus_refresh();
        monitoring = pthread_create(&monitor, NULL, watch, NULL) == 0;
    }
    if (monitoring)
        return event_pipe[0];
    pthread_mutex_lock(&lock);
    close_pipe(stop_pipe);
    close_pipe(event_pipe);
    pthread_mutex_unlock(&lock);
    return -1;
}

void bus_monitor_stop(void)
{
    if (!monitoring)
        return;
    close_pipe((int[]){-1, stop_pipe[1]}); /* the thread sees its end of the pipe hang up */
    pthread_join(monitor, NULL);
    stop_pipe[1] = -1;
    pthread_mutex_lock(&lock);
    close_pipe(stop_pipe);
    close_pipe(event_pipe);
    first_event = next_event;
    monitoring = false;
    pthread_mutex_unlock(&lock);
}

int bus_connect(int device)
{
    pthread_mutex_lock(&lock);
    const char *path = NULL;
    for (int i = 0; i < ports; i++)
        if (device && cameras[i].device == device)
            path = cameras[i].path;
    pthread_mutex_unlock(&lock);
    int sock = path ? usbip_import(path) : -1;
    if (sock < 0)
        errno = path ? ENODEV : ENOENT;
    return sock;
}

static int open_content(const void *data, size_t bytes)
{
    int fd = memfd_create("fake-camera", MFD_CLOEXEC);
    if (fd >= 0 && (write(fd, data, bytes) != (ssize_t)bytes || lseek(fd, 0, SEEK_SET) < 0)) {
        real_close(fd);
        return -1;
    }
    return fd;
}

int bus_open_attribute(const char *name)
{
    int bus, port, end = 0, fd = -1;
    errno = ENOENT;
    if (sscanf(name, "%d-%d/%n", &bus, &port, &end) != 2 || !end || bus != BUS_NUMBER || !bus_device_at(port))
        return -1;
    const char *attribute = name + end;
    char text[16] = "";
    pthread_mutex_lock(&lock);
    struct camera *camera = &cameras[port - 1];
    if (!strcmp(attribute, "descriptors"))
        fd = open_content(camera->descriptors, camera->descriptor_bytes);
    else if (!strcmp(attribute, "busnum"))
        snprintf(text, sizeof text, "%d\n", BUS_NUMBER);
    else if (!strcmp(attribute, "devnum"))
        snprintf(text, sizeof text, "%d\n", camera->device);
    else if (!strcmp(attribute, "speed"))
        strcpy(text, "5000\n");
    else if (!strcmp(attribute, "bConfigurationValue"))
        strcpy(text, "1\n");
    for (int i = 0; i < STRINGS; i++)
        if (!strcmp(attribute, string_names[i]))
            fd = open_content(camera->strings[i], strlen(camera->strings[i]));
    pthread_mutex_unlock(&lock);
    return *text ? open_content(text, strlen(text)) : fd;
}
