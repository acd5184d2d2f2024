/* A system clock that is wrong by CLOCK_AHEAD_S seconds, for one process: cc -shared -fPIC -o wrong_clock.so wrong_clock.c
   -ldl, then LD_PRELOAD. A clock that jumps is ahead by the int64 in the file CLOCK_AHEAD_FILE, which may change. Clocks
   that only count, as CLOCK_MONOTONIC, are right. */
#define _GNU_SOURCE
#include <dlfcn.h>
#include <fcntl.h>
#include <stdint.h>
#include <stdlib.h>
#include <sys/mman.h>
#include <sys/time.h>
#include <time.h>

static const volatile int64_t *jumps;

__attribute__((constructor)) static void watch(void) {
    const char *path = getenv("CLOCK_AHEAD_FILE");
    int fd = path ? open(path, O_RDONLY) : -1;
    void *mapped = fd < 0 ? MAP_FAILED : mmap(NULL, sizeof *jumps, PROT_READ, MAP_SHARED, fd, 0);
    if (mapped != MAP_FAILED)
        jumps = mapped;
}

static time_t ahead(void) {
    if (jumps)
        return (time_t)*jumps;
    const char *text = getenv("CLOCK_AHEAD_S");
    return text ? (time_t)atof(text) : 0;
}

int clock_gettime(clockid_t which, struct timespec *now) {
    static int (*real)(clockid_t, struct timespec *);
    if (!real)
        real = dlsym(RTLD_NEXT, "clock_gettime");
    int failed = real(which, now);
    if (!failed && (which == CLOCK_REALTIME || which == CLOCK_REALTIME_COARSE))
        now->tv_sec += ahead();
    return failed;
}

int gettimeofday(struct timeval *now, void *zone) {
    struct timespec right;
    int failed = clock_gettime(CLOCK_REALTIME, &right);
    now->tv_sec = right.tv_sec;
    now->tv_usec = right.tv_nsec / 1000;
    return failed;
}

time_t time(time_t *kept) {
    struct timespec now;
    clock_gettime(CLOCK_REALTIME, &now);
    if (kept)
        *kept = now.tv_sec;
    return now.tv_sec;
}
