/* SPDX-License-Identifier: MIT */
/* A planar five-bar linkage: two motors on one base line, a proximal link on each, two distal links that hold the end
 * point. Arm 0 turns about (0, 0), arm 1 about (base, 0); y points from the motors to the hand. SI units and radians. */
#ifndef PANTOGRAPH_H
#define PANTOGRAPH_H

#include <stdbool.h>

typedef struct {
    double proximal, distal, base; /* m */
} pantograph;

/* A pose: the end point, and per arm the distal link from elbow to end point and its lever (m^2): how far the link's
 * equation u . v = lever * omega turns the motor's speed into the end point's velocity. */
typedef struct {
    double point[2], link[2][2], lever[2];
} pantograph_pose;

/* Forward kinematics; false where the links do not reach, or lie in one line, where a force cannot be divided. */
bool pantograph_forward(const pantograph *arms, const double angle[2], pantograph_pose *pose);

/* Torques (N m) for a force (N) at the end point. Where one is above `limit`, both are made smaller by one factor, so
 * that the force keeps its direction; true where that was so. */
bool pantograph_torques(const pantograph_pose *pose, const double force[2], double limit, double torque[2]);

#endif
