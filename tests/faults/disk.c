/* Preloaded into the service: makes the disk of some files fail as a control file says.
 *
 * GRAPHFIX_FAULT_FILES is the beginning of the paths of these files, GRAPHFIX_FAULT names the
 * control file. Its content: "full" (ENOSPC on write), "broken" (EIO on write), "unsynced" (EIO on
 * fsync), "slow SECONDS" (fsync takes that long), anything else for no fault. */
#define _GNU_SOURCE
#include <dlfcn.h>
#include <errno.h>
#include <fcntl.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/types.h>
#include <unistd.h>

/* The fault in force for a file, or an empty text. */
static void fault_of(int file, char *fault, size_t size) {
    char link[64], path[4096];
    const char *files = getenv("GRAPHFIX_FAULT_FILES"), *control = getenv("GRAPHFIX_FAULT");
    fault[0] = 0;
    if (!files || !control) return;
    snprintf(link, sizeof link, "/proc/self/fd/%d", file);
    ssize_t length = readlink(link, path, sizeof path - 1);
    if (length < 0) return;
    path[length] = 0;
    if (strncmp(path, files, strlen(files)) != 0) return;
    int handle = open(control, O_RDONLY | O_CLOEXEC);
    if (handle < 0) return;
    length = read(handle, fault, size - 1);
    fault[length < 0 ? 0 : length] = 0;
    close(handle);
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
    if (strncmp(fault, "slow ", 5) == 0) sleep((unsigned)atoi(fault + 5));
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
