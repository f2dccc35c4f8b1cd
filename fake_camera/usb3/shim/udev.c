/* libudev as libusb's Linux backend uses it: to list what is on the bus, and to hear of what comes and goes. */
#define _GNU_SOURCE
#include "shim.h"

#include <dlfcn.h>
#include <elf.h>
#include <errno.h>
#include <link.h>
#include <pthread.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#define SYSTEM_PATH "/sys/bus/usb/devices/"

/* Programs also pass in lists of libudev's own (lsusb looks names up in its database): ours carry this mark. */
static const char mark;

struct udev_list_entry {
    const char *mark;
    struct udev_list_entry *next;
    char name[64];
};

struct udev_enumerate {
    struct udev_list_entry entries[MAX_CAMERAS];
    struct udev_list_entry *first;
};

struct udev_device {
    char name[16], node[32];
    const char *action;
};

struct udev_monitor {
    int fd;
};

struct udev;

/* --- does libusb need a function that is missing here? --- */

static const void *dynamic(const struct link_map *map, ElfW(Sxword) tag)
{
    for (const ElfW(Dyn) *entry = map->l_ld; entry->d_tag != DT_NULL; entry++)
        if (entry->d_tag == tag)
            return (const void *)entry->d_un.d_ptr;
    return NULL;
}

/* udev_new and udev_unref touch no device and are left to libudev. */
static bool is_missing(const char *name)
{
    if (strncmp(name, "udev_", 5) || !strcmp(name, "udev_new") || !strcmp(name, "udev_unref"))
        return false;
    Dl_info own, found;
    void *function = dlsym(RTLD_DEFAULT, name);
    return !function || !dladdr(&mark, &own) || !dladdr(function, &found) || found.dli_fbase != own.dli_fbase;
}

/* A library's symbol table begins with the symbols it imports; its hash table says how many they are. */
static void check_caller(const void *address)
{
    Dl_info caller;
    struct link_map *map;
    if (!dladdr1(address, &caller, (void **)&map, RTLD_DL_LINKMAP))
        return;
    const uint32_t *hash = dynamic(map, DT_GNU_HASH);
    const ElfW(Sym) *symbols = dynamic(map, DT_SYMTAB);
    const char *names = dynamic(map, DT_STRTAB);
    if (!hash || !symbols || !names)
        return;
    for (uint32_t i = 1; i < hash[1]; i++)
        if (symbols[i].st_shndx == SHN_UNDEF && is_missing(names + symbols[i].st_name)) {
            complain("%s needs %s, which is missing: add it to udev.c", caller.dli_fname, names + symbols[i].st_name);
            exit(1);
        }
}

/* --- devices --- */

static struct udev_device *new_device(int port, int device, const char *action)
{
    struct udev_device *new = calloc(1, sizeof *new);
    if (!new)
        return NULL;
    snprintf(new->name, sizeof new->name, "%d-%d", BUS_NUMBER, port);
    snprintf(new->node, sizeof new->node, "/dev/bus/usb/%03d/%03d", BUS_NUMBER, device);
    new->action = action;
    return new;
}

PUBLIC struct udev_device *udev_device_new_from_syspath(struct udev *udev, const char *path)
{
    (void)udev;
    int bus, port;
    if (sscanf(path, SYSTEM_PATH "%d-%d", &bus, &port) != 2 || bus != BUS_NUMBER || !bus_device_at(port)) {
        errno = ENOENT;
        return NULL;
    }
    return new_device(port, bus_device_at(port), NULL);
}

PUBLIC const char *udev_device_get_action(struct udev_device *device)
{
    return device->action;
}

PUBLIC const char *udev_device_get_devnode(struct udev_device *device)
{
    return device->node;
}

PUBLIC const char *udev_device_get_sysname(struct udev_device *device)
{
    return device->name;
}

PUBLIC struct udev_device *udev_device_unref(struct udev_device *device)
{
    free(device);
    return NULL;
}

/* --- enumeration: always of USB devices, whatever the match --- */

PUBLIC struct udev_enumerate *udev_enumerate_new(struct udev *udev)
{
    (void)udev;
    check_caller(__builtin_return_address(0));
    return calloc(1, sizeof(struct udev_enumerate));
}

PUBLIC int udev_enumerate_add_match_subsystem(struct udev_enumerate *enumerate, const char *subsystem)
{
    (void)enumerate, (void)subsystem;
    return 0;
}

PUBLIC int udev_enumerate_add_match_property(struct udev_enumerate *enumerate, const char *property, const char *value)
{
    (void)enumerate, (void)property, (void)value;
    return 0;
}

PUBLIC int udev_enumerate_scan_devices(struct udev_enumerate *enumerate)
{
    bus_refresh();
    struct udev_list_entry **end = &enumerate->first, *entry = enumerate->entries;
    for (int port = 1; port <= bus_ports(); port++) {
        if (!bus_device_at(port))
            continue;
        entry->mark = &mark;
        snprintf(entry->name, sizeof entry->name, SYSTEM_PATH "%d-%d", BUS_NUMBER, port);
        *end = entry;
        end = &entry++->next;
    }
    return 0;
}

PUBLIC struct udev_list_entry *udev_enumerate_get_list_entry(struct udev_enumerate *enumerate)
{
    return enumerate->first;
}

PUBLIC struct udev_enumerate *udev_enumerate_unref(struct udev_enumerate *enumerate)
{
    free(enumerate);
    return NULL;
}

static void *libudevs(const char *name)
{
    void *libudev = dlopen("libudev.so.1", RTLD_LAZY);
    return libudev ? dlsym(libudev, name) : NULL;
}

PUBLIC struct udev_list_entry *udev_list_entry_get_next(struct udev_list_entry *entry)
{
    if (!entry || entry->mark == &mark)
        return entry ? entry->next : NULL;
    struct udev_list_entry *(*next)(struct udev_list_entry *) = libudevs("udev_list_entry_get_next");
    return next ? next(entry) : NULL;
}

PUBLIC const char *udev_list_entry_get_name(struct udev_list_entry *entry)
{
    if (!entry || entry->mark == &mark)
        return entry ? entry->name : NULL;
    const char *(*name)(struct udev_list_entry *) = libudevs("udev_list_entry_get_name");
    return name ? name(entry) : NULL;
}

/* --- monitor --- */

PUBLIC struct udev_monitor *udev_monitor_new_from_netlink(struct udev *udev, const char *source)
{
    (void)udev, (void)source;
    check_caller(__builtin_return_address(0));
    struct udev_monitor *monitor = calloc(1, sizeof *monitor);
    if (monitor)
        monitor->fd = -1;
    return monitor;
}

PUBLIC int udev_monitor_filter_add_match_subsystem_devtype(struct udev_monitor *monitor, const char *subsystem,
                                                           const char *type)
{
    (void)monitor, (void)subsystem, (void)type;
    return 0;
}

PUBLIC int udev_monitor_enable_receiving(struct udev_monitor *monitor)
{
    monitor->fd = bus_monitor_start();
    return monitor->fd < 0 ? -EBUSY : 0;
}

PUBLIC int udev_monitor_get_fd(struct udev_monitor *monitor)
{
    return monitor->fd;
}

PUBLIC struct udev_device *udev_monitor_receive_device(struct udev_monitor *monitor)
{
    (void)monitor;
    struct bus_event event;
    bus_refresh(); /* so that a program that lists the devices sees the current ones */
    if (!bus_next_event(&event))
        return NULL;
    return new_device(event.port, event.device, event.arrived ? "add" : "remove");
}

PUBLIC struct udev_monitor *udev_monitor_unref(struct udev_monitor *monitor)
{
    if (monitor && monitor->fd >= 0)
        bus_monitor_stop();
    free(monitor);
    return NULL;
}
