/* Counts the system calls that change what lies under a folder, and has one of them go wrong.
 *
 * Preloaded (LD_PRELOAD) into a process, which says by `shim_arm` what goes wrong and when. A call of a shared library counts; what
 * the C library does within itself, as fwrite does, does not. */
#define _GNU_SOURCE
#include <dlfcn.h>
#include <errno.h>
#include <fcntl.h>
#include <limits.h>
#include <signal.h>
#include <stdarg.h>
#include <stdio.h>
#include <string.h>
#include <sys/file.h>
#include <sys/stat.h>
#include <sys/uio.h>
#include <unistd.h>

enum { NOTHING, KILL, FULL, READ_ONLY, SIGNAL_INT, SIGNAL_TERM, STOP, NO_LOCKS };

static char under[PATH_MAX];
static long at = 0;
static int mode = NOTHING;
static long *counted = 0; /* shared with the process that forked this one */

void shim_arm(const char *folder, long number, int what, long *count) {
    strncpy(under, folder, sizeof under - 1);
    at = number;
    mode = what;
    counted = count;
}

static int inside(const char *path) { return path && strncmp(path, under, strlen(under)) == 0; }

static int of_descriptor(int fd) {
    char link[64], path[PATH_MAX];
    snprintf(link, sizeof link, "/proc/self/fd/%d", fd);
    ssize_t n = readlink(link, path, sizeof path - 1);
    if (n < 0) return 0;
    path[n] = 0;
    return inside(path);
}

static int of_path(int folder, const char *path) {
    if (path && path[0] == '/') return inside(path);
    char here[PATH_MAX];
    return folder == AT_FDCWD ? getcwd(here, sizeof here) && inside(here) : of_descriptor(folder);
}

/* One more call; not 0 where it is to fail with errno. `room`: whether it needs space on the disk. */
static int refused(int room, int fd, const void *bytes, size_t size) {
    long number = __atomic_add_fetch(counted, 1, __ATOMIC_SEQ_CST);
    if (mode == READ_ONLY) return errno = EROFS, 1;
    if (mode == FULL) return number >= at && room ? (errno = ENOSPC, 1) : 0;
    if (number != at) return 0;
    if (mode == KILL) {
        ssize_t (*real)(int, const void *, size_t) = dlsym(RTLD_NEXT, "write");
        if (bytes && size > 1 && real(fd, bytes, size / 2) < 0) errno = 0; /* half of it gets there */
        kill(getpid(), SIGKILL);
    }
    if (mode == SIGNAL_INT) kill(getpid(), SIGINT);
    if (mode == SIGNAL_TERM) kill(getpid(), SIGTERM);
    if (mode == STOP) {
        mode = NOTHING; /* the second writer counts as well */
        kill(getpid(), SIGSTOP);
    }
    return 0;
}

#define REAL(type, name, ...) type (*real)(__VA_ARGS__) = dlsym(RTLD_NEXT, name)

ssize_t write(int fd, const void *bytes, size_t size) {
    REAL(ssize_t, "write", int, const void *, size_t);
    return counted && of_descriptor(fd) && refused(1, fd, bytes, size) ? -1 : real(fd, bytes, size);
}
ssize_t writev(int fd, const struct iovec *parts, int count) {
    REAL(ssize_t, "writev", int, const struct iovec *, int);
    return counted && of_descriptor(fd) && refused(1, fd, 0, 0) ? -1 : real(fd, parts, count);
}
ssize_t pwrite64(int fd, const void *bytes, size_t size, off64_t offset) {
    REAL(ssize_t, "pwrite64", int, const void *, size_t, off64_t);
    return counted && of_descriptor(fd) && refused(1, fd, 0, 0) ? -1 : real(fd, bytes, size, offset);
}
ssize_t pwrite(int fd, const void *bytes, size_t size, off_t offset) { return pwrite64(fd, bytes, size, offset); }
/* What a process has written stays when it is killed: no test waits for the disk. */
int fsync(int fd) {
    REAL(int, "fsync", int);
    return counted && of_descriptor(fd) ? (refused(1, fd, 0, 0) ? -1 : 0) : real(fd);
}
int fdatasync(int fd) {
    REAL(int, "fdatasync", int);
    return counted && of_descriptor(fd) ? (refused(1, fd, 0, 0) ? -1 : 0) : real(fd);
}
int ftruncate64(int fd, off64_t size) {
    REAL(int, "ftruncate64", int, off64_t);
    return counted && of_descriptor(fd) && refused(0, fd, 0, 0) ? -1 : real(fd, size);
}
int ftruncate(int fd, off_t size) { return ftruncate64(fd, size); }

static int opened(const char *name, int folder, const char *path, int flags, mode_t permissions) {
    REAL(int, name, int, const char *, int, mode_t);
    int changes = (flags & (O_CREAT | O_TRUNC)) || (flags & O_TMPFILE) == O_TMPFILE;
    if (counted && changes && of_path(folder, path) && refused(0, -1, 0, 0)) return -1;
    return real(folder, path, flags, permissions);
}
#define OPEN(name, at_name, before, folder)                             \
    int name(before const char *path, int flags, ...) {                 \
        va_list more;                                                   \
        va_start(more, flags);                                          \
        mode_t permissions = va_arg(more, mode_t);                      \
        va_end(more);                                                   \
        return opened(at_name, folder, path, flags, permissions);       \
    }
#define NONE
#define FOLDER int folder,
OPEN(open, "openat", NONE, AT_FDCWD)
OPEN(open64, "openat64", NONE, AT_FDCWD)
OPEN(openat, "openat", FOLDER, folder)
OPEN(openat64, "openat64", FOLDER, folder)

int mkdirat(int folder, const char *path, mode_t permissions) {
    REAL(int, "mkdirat", int, const char *, mode_t);
    return counted && of_path(folder, path) && refused(0, -1, 0, 0) ? -1 : real(folder, path, permissions);
}
int mkdir(const char *path, mode_t permissions) { return mkdirat(AT_FDCWD, path, permissions); }
int unlinkat(int folder, const char *path, int flags) {
    REAL(int, "unlinkat", int, const char *, int);
    return counted && of_path(folder, path) && refused(0, -1, 0, 0) ? -1 : real(folder, path, flags);
}
int unlink(const char *path) { return unlinkat(AT_FDCWD, path, 0); }
int rmdir(const char *path) { return unlinkat(AT_FDCWD, path, AT_REMOVEDIR); }
int renameat(int folder, const char *path, int to_folder, const char *to) {
    REAL(int, "renameat", int, const char *, int, const char *);
    int counts = counted && (of_path(folder, path) || of_path(to_folder, to));
    return counts && refused(0, -1, 0, 0) ? -1 : real(folder, path, to_folder, to);
}
int rename(const char *path, const char *to) { return renameat(AT_FDCWD, path, AT_FDCWD, to); }

int flock(int fd, int operation) { /* of a file system without locks: NFS says the first, others the second */
    REAL(int, "flock", int, int);
    if (counted && mode == NO_LOCKS && of_descriptor(fd)) return errno = at == 1 ? ENOLCK : EOPNOTSUPP, -1;
    return real(fd, operation);
}
