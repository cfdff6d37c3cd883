/* Preloaded into a program: makes the disk of some files, the clock and new descriptors fail as a
 * control file says.
 *
 * GRAPHFIX_FAULT_FILES is the beginning of the paths of these files, GRAPHFIX_FAULT names the
 * control file. Its content: "full" (ENOSPC on write), "broken" (EIO on write), "unsynced" (EIO on
 * fsync), "slow SECONDS" (fsync takes that long), "clock SECONDS" (the time of day is that much
 * ahead), anything else for no fault. */
#define _GNU_SOURCE
#include <dlfcn.h>
#include <errno.h>
#include <fcntl.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/types.h>
#include <time.h>
#include <unistd.h>

/* The fault in force, or an empty text. The control file stays open, for there may be no other
 * descriptor. */
static void fault(char *found, size_t size) {
    static int handle = -1;
    const char *control = getenv("GRAPHFIX_FAULT");
    if (handle < 0 && control) handle = open(control, O_RDONLY | O_CLOEXEC);
    ssize_t length = handle < 0 ? 0 : pread(handle, found, size - 1, 0);
    found[length < 0 ? 0 : length] = 0;
}

/* The same for a file; an empty text where its disk does not fail. */
static void fault_of(int file, char *found, size_t size) {
    char link[64], path[4096];
    const char *files = getenv("GRAPHFIX_FAULT_FILES");
    found[0] = 0;
    snprintf(link, sizeof link, "/proc/self/fd/%d", file);
    ssize_t length = files ? readlink(link, path, sizeof path - 1) : -1;
    if (length < 0) return;
    path[length] = 0;
    if (strncmp(path, files, strlen(files)) == 0) fault(found, size);
}

static int write_fails(int file) {
    char fault[64];
    fault_of(file, fault, sizeof fault);
    if (strncmp(fault, "full", 4) == 0) return errno = ENOSPC, 1;
    if (strncmp(fault, "broken", 6) == 0) return errno = EIO, 1;
    return 0;
}

static int sync_fails(int file) {
    char fault[64];
    fault_of(file, fault, sizeof fault);
    if (strncmp(fault, "unsynced", 8) == 0) return errno = EIO, 1;
    unsigned left_s = strncmp(fault, "slow ", 5) == 0 ? (unsigned)atoi(fault + 5) : 0;
    while (left_s) left_s = sleep(left_s); /* A signal ends a sleep. */
    return 0;
}

#define NEXT(name, type) ((type)dlsym(RTLD_NEXT, name))

ssize_t pwrite64(int file, const void *bytes, size_t size, off64_t at) {
    if (write_fails(file)) return -1;
    return NEXT("pwrite64", ssize_t (*)(int, const void *, size_t, off64_t))(file, bytes, size, at);
}

ssize_t pwrite(int file, const void *bytes, size_t size, off_t at) {
    if (write_fails(file)) return -1;
    return NEXT("pwrite", ssize_t (*)(int, const void *, size_t, off_t))(file, bytes, size, at);
}

int fsync(int file) {
    if (sync_fails(file)) return -1;
    return NEXT("fsync", int (*)(int))(file);
}

int fdatasync(int file) {
    if (sync_fails(file)) return -1;
    return NEXT("fdatasync", int (*)(int))(file);
}

int clock_gettime(clockid_t clock, struct timespec *time) {
    int result = NEXT("clock_gettime", int (*)(clockid_t, struct timespec *))(clock, time);
    char now[64];
    if (clock != CLOCK_REALTIME || result != 0) return result;
    fault(now, sizeof now);
    if (strncmp(now, "clock ", 6) == 0) time->tv_sec += atoll(now + 6);
    return 0;
}
