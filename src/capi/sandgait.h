/* Sand's forces on rigid bodies that another simulator moves. Frame: the caller's world, z up, SI units.
 *
 * Functions that return a pointer return NULL, and those that return an int return -1, after an error; sandgait_error()
 * then is one line of text. Sand and bodies do not change after they are made, so any number of threads may use them. */
#ifndef SANDGAIT_H
#define SANDGAIT_H

#include <stddef.h>

#ifdef __cplusplus
extern "C" {
#endif

typedef struct sandgait_sand sandgait_sand;
typedef struct sandgait_bodies sandgait_bodies;

/* A shape at its place in a body's frame; quaternions are (w, x, y, z). */
typedef struct {
    const char *shape; /* "sphere:radius=0.02", "mesh:foot.stl", ...: the names of sandgait.Bodies */
    size_t body;       /* number of the body; bodies count from 0 */
    double position[3];
    double quaternion[4];
} sandgait_shape;

/* The last error of this thread; valid until its next call of a function of this library. */
const char *sandgait_error(void);

/* Sand below the plane at `height` [m] that rises towards +x by `slope_deg`. `medium` and `law` ("li2013",
 * "agarwal2023") as in `sandgait media`; or a file sand.toml with its own law. */
sandgait_sand *sandgait_sand_named(const char *medium, const char *law, double height, double slope_deg);
sandgait_sand *sandgait_sand_load(const char *file, double height, double slope_deg);
void sandgait_sand_free(sandgait_sand *sand);

/* `plate_size` [m]; 0: 256 plates for a shape, up to 512 if it is curved. */
sandgait_bodies *sandgait_bodies_new(const sandgait_shape *shapes, size_t count, double plate_size);
size_t sandgait_bodies_count(const sandgait_bodies *bodies);
void sandgait_bodies_free(sandgait_bodies *bodies);

/* Force [N] and torque about each body's origin [N m] in the world's axes: `wrench` is [states][bodies][6]. `position`,
 * `velocity` of the origins and `angular_velocity` are [states][bodies][3], `quaternion` is [states][bodies][4]. `drag` is
 * NULL or [states][bodies][6][6]: -d(wrench)/d(velocity, angular velocity) as the secant from rest. `threads`: the most to
 * use. Returns 0. */
int sandgait_wrench(const sandgait_sand *sand, const sandgait_bodies *bodies, size_t states, const double *position,
                    const double *quaternion, const double *velocity, const double *angular_velocity, double *wrench,
                    double *drag, size_t threads);

#ifdef __cplusplus
}
#endif

#endif
