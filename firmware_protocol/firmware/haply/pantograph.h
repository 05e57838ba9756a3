/* SPDX-License-Identifier: MIT */
/* A planar five-bar linkage: two motors on one base line, a proximal link on each motor, and two distal links that hold
 * the end point. Arm 0 turns about (0, 0), arm 1 about (base, 0); y points from the motors to the hand. SI units and
 * radians. */
#ifndef PANTOGRAPH_H
#define PANTOGRAPH_H

#include <stdbool.h>

typedef struct {
    double proximal, distal, base; /* m */
} pantograph;

/* A pose: the end point, and for each arm the distal link u from elbow to end point and its lever (m^2). The lever
 * relates the motor's speed to the end point's velocity: u . v = lever * omega. */
typedef struct {
    double point[2], link[2][2], lever[2];
} pantograph_pose;

/* Computes the pose. Returns false if the links do not reach, or lie in one line, where a force cannot be divided. */
bool pantograph_forward(const pantograph *arms, const double angle[2], pantograph_pose *pose);

/* Computes the torques (N m) for a force (N) at the end point. If one exceeds `limit`, scales both by one factor, so
 * that the force keeps its direction, and returns true. */
bool pantograph_torques(const pantograph_pose *pose, const double force[2], double limit, double torque[2]);

#endif
