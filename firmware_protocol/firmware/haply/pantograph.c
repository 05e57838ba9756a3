/* SPDX-License-Identifier: MIT */
#include "pantograph.h"

#include <math.h>

/* In units of the distal link. Closer to a line, encoder counts and play would decide where the end point goes. */
#define NEARLY_IN_LINE 1e-3

static double cross(const double a[2], const double b[2]) {
    return a[0] * b[1] - a[1] * b[0];
}

bool pantograph_forward(const pantograph *arms, const double angle[2], pantograph_pose *pose) {
    double elbow[2][2], between[2];
    for (int i = 0; i < 2; i++) {
        elbow[i][0] = i * arms->base + arms->proximal * cos(angle[i]);
        elbow[i][1] = arms->proximal * sin(angle[i]);
    }
    for (int axis = 0; axis < 2; axis++) {
        between[axis] = elbow[1][axis] - elbow[0][axis];
    }
    /* Both distal links have the same length. So the end point is on the perpendicular through the middle of the
     * elbows, on their far side. */
    const double half = hypot(between[0], between[1]) / 2, square = arms->distal * arms->distal - half * half;
    if (!(half > NEARLY_IN_LINE * arms->distal && square > pow(NEARLY_IN_LINE * arms->distal, 2))) {
        return false;
    }
    const double height = sqrt(square) / (2 * half);
    pose->point[0] = (elbow[0][0] + elbow[1][0]) / 2 - height * between[1];
    pose->point[1] = (elbow[0][1] + elbow[1][1]) / 2 + height * between[0];
    for (int i = 0; i < 2; i++) {
        const double along[2] = {-elbow[i][1], elbow[i][0] - i * arms->base}; /* d elbow / d angle */
        for (int axis = 0; axis < 2; axis++) {
            pose->link[i][axis] = pose->point[axis] - elbow[i][axis];
        }
        pose->lever[i] = pose->link[i][0] * along[0] + pose->link[i][1] * along[1];
    }
    return true;
}

/* Applies the transpose of the Jacobian without computing the Jacobian. The force is divided into one force along each
 * distal link. Each of these turns its motor by its lever. */
bool pantograph_torques(const pantograph_pose *pose, const double force[2], double limit, double torque[2]) {
    const double area = cross(pose->link[0], pose->link[1]);
    torque[0] = pose->lever[0] * cross(force, pose->link[1]) / area;
    torque[1] = pose->lever[1] * cross(pose->link[0], force) / area;
    const double largest = fmax(fabs(torque[0]), fabs(torque[1]));
    if (largest <= limit) {
        return false;
    }
    torque[0] *= limit / largest;
    torque[1] *= limit / largest;
    return true;
}
