/* Lets a program see another time of day: seconds in the file $SHIFT are added to it. Monotonic clocks stay. */
#define _GNU_SOURCE
#include <stdio.h>
#include <stdlib.h>
#include <sys/syscall.h>
#include <time.h>
#include <unistd.h>

int clock_gettime(clockid_t clock, struct timespec *now) {
    int result = (int)syscall(SYS_clock_gettime, clock, now);
    if (clock == CLOCK_REALTIME) {
        long shift = 0;
        FILE *file = fopen(getenv("SHIFT"), "r");
        if (file) {
            if (fscanf(file, "%ld", &shift) != 1)
                shift = 0;
            fclose(file);
        }
        now->tv_sec += shift;
    }
    return result;
}
