/* A ball and a shank of two shapes in loose poppy seeds.
 * cc example.c -I.. -lsandgait_capi -lm -lpthread -ldl */
#include "sandgait.h"
#include <stdio.h>

int main(void) {
    sandgait_sand *sand = sandgait_sand_named("poppy-loose", "agarwal2023", 0.0, 0.0);
    sandgait_shape shapes[] = {
        {"sphere:radius=0.02", 0, {0, 0, 0}, {1, 0, 0, 0}},
        {"capsule:radius=0.01,height=0.2", 1, {0, 0, 0.1}, {1, 0, 0, 0}},
        {"sphere:radius=0.02", 1, {0, 0, 0}, {1, 0, 0, 0}},
    };
    sandgait_bodies *bodies = sandgait_bodies_new(shapes, 3, 0.0);
    if (!sand || !bodies) {
        fprintf(stderr, "%s\n", sandgait_error());
        return 1;
    }
    double position[2][3] = {{0, 0, -0.01}, {1, 0, -0.01}}, quaternion[2][4] = {{1, 0, 0, 0}, {1, 0, 0, 0}};
    double velocity[2][3] = {{0.05, 0, -0.1}, {0.05, 0, -0.1}}, spin[2][3] = {{0, 1, 0}, {0, 1, 0}};
    double wrench[2][6], drag[2][6][6];
    if (sandgait_wrench(sand, bodies, 1, *position, *quaternion, *velocity, *spin, *wrench, **drag, 1)) {
        fprintf(stderr, "%s\n", sandgait_error());
        return 1;
    }
    for (int body = 0; body < 2; body++)
        printf("%.17g %.17g %.17g %.17g\n", wrench[body][0], wrench[body][2], wrench[body][4], drag[body][2][2]);
    quaternion[1][0] = 2;
    if (sandgait_wrench(sand, bodies, 1, *position, *quaternion, *velocity, *spin, *wrench, NULL, 1))
        printf("%s\n", sandgait_error());
    if (!sandgait_sand_named("gravel", "li2013", 0.0, 0.0))
        printf("%s\n", sandgait_error());
    sandgait_bodies_free(bodies);
    sandgait_sand_free(sand);
    return 0;
}
