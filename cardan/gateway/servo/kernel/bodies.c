#include "bodies.h"

#include <float.h>
#include <stdbool.h>

#include "vectors.h"

/* Cores nearer than this count as touching: a normal from so short a difference has no digits. */
#define TOUCHING_M 1e-12

/* Cross products of unit vectors shorter than this are of parallel ones. */
#define PARALLEL 1e-9

/* Of the nearest points of boxes, relative to how far these and their middles are apart: those of
 * edges that are nearly parallel have as few digits. */
#define ROUNDING 1e-13

void body_place(const KernelShape *shape, const Placement *at, Body *body)
{
    double moved[3];
    body->kind = shape->kind;
    if (shape->kind == SHAPE_CAPSULE) {
        turn3(at->rotation, shape->start, moved);
        along3(at->position, 1.0, moved, body->start);
        turn3(at->rotation, shape->end, moved);
        along3(at->position, 1.0, moved, body->end);
        body->radius_m = shape->radius_m;
        double along[3];
        subtract3(body->end, body->start, along);
        along3(body->start, 0.5, along, body->middle);
        body->around_m = 0.5 * norm3(along) + shape->radius_m;
    } else if (shape->kind == SHAPE_BOX) {
        turn3(at->rotation, shape->position, moved);
        along3(at->position, 1.0, moved, body->position);
        multiply33(at->rotation, shape->rotation, body->rotation);
        copy3(shape->half_m, body->half_m);
        copy3(body->position, body->middle);
        body->around_m = norm3(shape->half_m);
    } else {
        copy3(shape->normal, body->normal);
        body->offset_m = shape->offset_m;
    }
}

/* Nearest points of two segments (Ericson 2005, 5.1.9); squared distance. */
static double segments(const double a0[3], const double a1[3], const double b0[3],
                       const double b1[3], double on_a[3], double on_b[3])
{
    double along_a[3], along_b[3], between[3];
    subtract3(a1, a0, along_a);
    subtract3(b1, b0, along_b);
    subtract3(a0, b0, between);
    double a = dot3(along_a, along_a), e = dot3(along_b, along_b), f = dot3(along_b, between);
    double s = 0.0, t = 0.0;
    if (a > 0.0 && e > 0.0) {
        double c = dot3(along_a, between), b = dot3(along_a, along_b), square = a * e - b * b;
        s = square > 0.0 ? clamp((b * f - c * e) / square, 0.0, 1.0) : 0.0;
        t = (b * s + f) / e;
        if (t < 0.0) {
            t = 0.0;
            s = clamp(-c / a, 0.0, 1.0);
        } else if (t > 1.0) {
            t = 1.0;
            s = clamp((b - c) / a, 0.0, 1.0);
        }
    } else if (a > 0.0) {
        s = clamp(-dot3(along_a, between) / a, 0.0, 1.0);
    } else if (e > 0.0) {
        t = clamp(f / e, 0.0, 1.0);
    }
    along3(a0, s, along_a, on_a);
    along3(b0, t, along_b, on_b);
    subtract3(on_b, on_a, between);
    return dot3(between, between);
}

/* Some unit vector square to `along` and, where that is possible, to `other`. */
static void square_to(const double along[3], const double other[3], double out[3])
{
    cross3(along, other, out);
    double length = norm3(out);
    if (!(length > PARALLEL * norm3(along) * norm3(other)) || length == 0.0) {
        const double axes[3][3] = {{1.0, 0.0, 0.0}, {0.0, 1.0, 0.0}, {0.0, 0.0, 1.0}};
        int least = 0;
        for (int i = 1; i < 3; i++)
            if (fabs(along[i]) < fabs(along[least]))
                least = i;
        cross3(along, axes[least], out);
        length = norm3(out);
        if (length == 0.0) {
            copy3(axes[2], out);
            return;
        }
    }
    for (int i = 0; i < 3; i++)
        out[i] /= length;
}

static void capsules(const Body *first, const Body *second, Separation *out)
{
    double on_first[3], on_second[3];
    double core = sqrt(segments(first->start, first->end, second->start, second->end, on_first,
                                on_second));
    if (core > TOUCHING_M) {
        for (int i = 0; i < 3; i++)
            out->normal[i] = (on_second[i] - on_first[i]) / core;
    } else {
        double one[3], other[3];
        subtract3(first->end, first->start, one);
        subtract3(second->end, second->start, other);
        square_to(one, other, out->normal);
    }
    out->distance_m = core - first->radius_m - second->radius_m;
    along3(on_second, -second->radius_m, out->normal, out->point);
}

/* Half-space first. */
static void plane_and_capsule(const Body *plane, const Body *capsule, Separation *out)
{
    double start = dot3(plane->normal, capsule->start), end = dot3(plane->normal, capsule->end);
    const double *lowest = start <= end ? capsule->start : capsule->end;
    out->distance_m = smaller(start, end) - plane->offset_m - capsule->radius_m;
    copy3(plane->normal, out->normal);
    along3(lowest, -capsule->radius_m, plane->normal, out->point);
}

static void plane_and_box(const Body *plane, const Body *box, Separation *out)
{
    double lowest[3], across[3];
    turn_back3(box->rotation, plane->normal, across);
    copy3(box->position, lowest);
    for (int row = 0; row < 3; row++)
        for (int i = 0; i < 3; i++)
            lowest[row] -= copysign(box->half_m[i], across[i]) * box->rotation[3 * row + i];
    out->distance_m = dot3(plane->normal, lowest) - plane->offset_m;
    copy3(plane->normal, out->normal);
    copy3(lowest, out->point);
}

/* Half the slope of the squared distance of the box from start + t * along, in the box's axes. */
static double slope(const double start[3], const double along[3], const double half[3], double t)
{
    double sum = 0.0;
    for (int i = 0; i < 3; i++) {
        double at = start[i] + t * along[i];
        sum += along[i] * (at - clamp(at, -half[i], half[i]));
    }
    return sum;
}

/* Nearest points of a segment and a box about the origin; returns their squared distance. It is
 * convex along the segment, its slope linear between the planes of the faces. */
static double segment_and_box(const double start[3], const double end[3], const double half[3],
                              double on_segment[3], double on_box[3])
{
    double along[3], low = 0.0, high = 1.0;
    subtract3(end, start, along);
    double at_low = slope(start, along, half, low), at_high = slope(start, along, half, high);
    if (at_low >= 0.0) {
        high = low;
    } else if (at_high <= 0.0) {
        low = high;
    } else {
        for (int i = 0; i < 3; i++) {
            for (int side = -1; side <= 1; side += 2) {
                if (along[i] == 0.0)
                    continue;
                double t = (side * half[i] - start[i]) / along[i];
                if (!(t > low && t < high))
                    continue;
                double here = slope(start, along, half, t);
                if (here > 0.0) {
                    high = t;
                    at_high = here;
                } else {
                    low = t;
                    at_low = here;
                }
            }
        }
        double rise = at_high - at_low;
        low += rise > 0.0 ? (high - low) * clamp(-at_low / rise, 0.0, 1.0) : 0.0;
    }
    double square = 0.0;
    along3(start, low, along, on_segment);
    for (int i = 0; i < 3; i++) {
        on_box[i] = clamp(on_segment[i], -half[i], half[i]);
        square += (on_segment[i] - on_box[i]) * (on_segment[i] - on_box[i]);
    }
    return square;
}

/* How far the segment must be pushed out of the box that it meets, and the way: the least over the
 * faces of their Minkowski difference, which are square to a face of the box or to one of its
 * edges and the segment. Box axes. */
static double depth_of_segment(const double start[3], const double end[3], const double half[3],
                               double normal[3], double on_segment[3])
{
    double middle[3], reach[3], least = INFINITY;
    int edge = -1;
    for (int i = 0; i < 3; i++) {
        middle[i] = 0.5 * (start[i] + end[i]);
        reach[i] = 0.5 * (end[i] - start[i]);
    }
    for (int i = 0; i < 3; i++) {
        double depth = half[i] + fabs(reach[i]) - fabs(middle[i]);
        if (depth < least) {
            least = depth;
            normal[0] = normal[1] = normal[2] = 0.0;
            normal[i] = copysign(1.0, middle[i]);
        }
    }
    double length = norm3(reach);
    for (int i = 0; i < 3 && length > 0.0; i++) {
        double axis[3] = {0.0, 0.0, 0.0}, across[3];
        axis[i] = 1.0;
        cross3(axis, reach, across);
        double size = norm3(across);
        if (!(size > PARALLEL * length))
            continue;
        double away = dot3(across, middle) / size, share = copysign(1.0 / size, away), depth = 0.0;
        for (int j = 0; j < 3; j++)
            depth += half[j] * fabs(across[j]) / size;
        depth -= fabs(away);
        if (depth < least) {
            least = depth;
            edge = i;
            for (int j = 0; j < 3; j++)
                normal[j] = share * across[j];
        }
    }
    if (edge < 0) {
        double side = dot3(normal, reach);
        along3(middle, side > 0.0 ? -1.0 : side < 0.0 ? 1.0 : 0.0, reach, on_segment);
    } else {
        double low[3], high[3], on_edge[3];
        for (int j = 0; j < 3; j++)
            low[j] = high[j] = copysign(half[j], normal[j]);
        low[edge] = -half[edge];
        high[edge] = half[edge];
        segments(start, end, low, high, on_segment, on_edge);
    }
    return least;
}

/* Capsule first. */
static void capsule_and_box(const Body *capsule, const Body *box, Separation *out)
{
    double from[3], start[3], end[3], on_segment[3], on_box[3], normal[3];
    subtract3(capsule->start, box->position, from);
    turn_back3(box->rotation, from, start);
    subtract3(capsule->end, box->position, from);
    turn_back3(box->rotation, from, end);
    double core = sqrt(segment_and_box(start, end, box->half_m, on_segment, on_box));
    if (core > TOUCHING_M) {
        for (int i = 0; i < 3; i++)
            normal[i] = (on_box[i] - on_segment[i]) / core;
    } else {
        core = -depth_of_segment(start, end, box->half_m, normal, on_segment);
        for (int i = 0; i < 3; i++)
            normal[i] = -normal[i];
        along3(on_segment, core, normal, on_box);
    }
    out->distance_m = core - capsule->radius_m;
    turn3(box->rotation, normal, out->normal);
    turn3(box->rotation, on_box, from);
    along3(box->position, 1.0, from, out->point);
}

typedef struct {
    double square;
    double on_first[3], on_second[3]; /* axes of the first box */
    int features;
} Nearest;

/* Numbers of the features that points are on: a corner of the second box, a corner of the first, an
 * edge of each. */
#define OF_SECOND 1
#define OF_FIRST (OF_SECOND + 8)
#define OF_EDGES (OF_FIRST + 8)

static void keep_nearer(Nearest *nearest, const double on_first[3], const double on_second[3],
                        int features)
{
    double between[3];
    subtract3(on_second, on_first, between);
    double square = dot3(between, between);
    if (square < nearest->square) {
        nearest->square = square;
        nearest->features = features;
        copy3(on_first, nearest->on_first);
        copy3(on_second, nearest->on_second);
    }
}

static void corner(const double half[3], int which, double out[3])
{
    for (int i = 0; i < 3; i++)
        out[i] = which >> i & 1 ? half[i] : -half[i];
}

/* Edge 0 to 11: its middle, and its axis as the result. */
static int edge_middle(const double half[3], int which, double out[3])
{
    int axis = which >> 2, next = (axis + 1) % 3, last = (axis + 2) % 3;
    out[axis] = 0.0;
    out[next] = which & 1 ? half[next] : -half[next];
    out[last] = which & 2 ? half[last] : -half[last];
    return axis;
}

/* Two boxes, the second at `middle` and `turned` in the axes of the first. */
typedef struct {
    const double *a, *b; /* half their edges */
    double turned[9], middle[3];
} Boxes;

/* A point of the second box, in the axes of the first. */
static void of_second(const Boxes *boxes, const double point[3], double out[3])
{
    double moved[3];
    turn3(boxes->turned, point, moved);
    along3(boxes->middle, 1.0, moved, out);
}

/* What lies between two boxes, the second at `middle` and `turned` in the axes of the first. */
typedef struct {
    double most;                     /* largest gap along the normals of their faces */
    double of_first[3], of_second[3]; /* signs of the faces of each that the other is beyond */
} Faces;

static void between_faces(const double a[3], const double b[3], const double turned[9],
                          const double middle[3], Faces *faces)
{
    double other[3];
    turn_back3(turned, middle, other);
    faces->most = -INFINITY;
    for (int i = 0; i < 3; i++) {
        double gap_a = fabs(middle[i]) - a[i], gap_b = fabs(other[i]) - b[i];
        for (int j = 0; j < 3; j++) {
            gap_a -= fabs(turned[3 * i + j]) * b[j];
            gap_b -= fabs(turned[3 * j + i]) * a[j];
        }
        faces->of_first[i] = gap_a > 0.0 ? copysign(1.0, middle[i]) : 0.0;
        faces->of_second[i] = gap_b > 0.0 ? copysign(1.0, -other[i]) : 0.0;
        double gap = gap_a > gap_b ? gap_a : gap_b;
        if (gap > faces->most)
            faces->most = gap;
    }
}

/* Whether a point of an edge (`axis` -1: a corner) can be the nearest of its box, where the other one
 * is beyond the faces that `beyond` has the signs of: only if it is an edge of all these faces. */
static bool can_be_nearest(const double edge[3], int axis, const double beyond[3])
{
    for (int i = 0; i < 3; i++)
        if (beyond[i] != 0.0 && (i == axis || edge[i] * beyond[i] < 0.0))
            return false;
    return true;
}

static void try_corner_of_second(const Boxes *boxes, int which, Nearest *nearest)
{
    double point[3], other[3];
    corner(boxes->b, which, point);
    of_second(boxes, point, other);
    for (int i = 0; i < 3; i++)
        point[i] = clamp(other[i], -boxes->a[i], boxes->a[i]);
    keep_nearer(nearest, point, other, OF_SECOND + which);
}

static void try_corner_of_first(const Boxes *boxes, int which, Nearest *nearest)
{
    double point[3], other[3], moved[3];
    corner(boxes->a, which, point);
    subtract3(point, boxes->middle, moved);
    turn_back3(boxes->turned, moved, other);
    for (int i = 0; i < 3; i++)
        moved[i] = clamp(other[i], -boxes->b[i], boxes->b[i]);
    of_second(boxes, moved, other);
    keep_nearer(nearest, point, other, OF_FIRST + which);
}

/* Edge `first` of the first box, and `second`, of which the middle is `at`. */
static void try_edges(const Boxes *boxes, int first, int second, const double at[3],
                      Nearest *nearest)
{
    double start[3], end[3], from[3], to[3], on_first[3], on_second[3];
    int axis = edge_middle(boxes->a, first, start), along = second >> 2;
    copy3(start, end);
    start[axis] = -boxes->a[axis];
    end[axis] = boxes->a[axis];
    const double axis_b[3] = {boxes->turned[along], boxes->turned[3 + along],
                              boxes->turned[6 + along]};
    along3(at, -boxes->b[along], axis_b, from);
    along3(at, boxes->b[along], axis_b, to);
    segments(start, end, from, to, on_first, on_second);
    keep_nearer(nearest, on_first, on_second, OF_EDGES + 12 * first + second);
}

/* The nearest points of features that were nearest. */
static void try_features(const Boxes *boxes, int features, Nearest *nearest)
{
    if (features >= OF_EDGES) {
        int first = (features - OF_EDGES) / 12, second = (features - OF_EDGES) % 12;
        double point[3], at[3];
        edge_middle(boxes->b, second, point);
        of_second(boxes, point, at);
        try_edges(boxes, first, second, at, nearest);
    } else if (features >= OF_FIRST) {
        try_corner_of_first(boxes, features - OF_FIRST, nearest);
    } else {
        try_corner_of_second(boxes, features - OF_SECOND, nearest);
    }
}

/* How far apart two boxes are at least: what is between them along the line through two points. */
static double gap_along(const Boxes *boxes, const Nearest *nearest)
{
    double along[3], own[3];
    subtract3(nearest->on_second, nearest->on_first, along);
    turn_back3(boxes->turned, along, own);
    double gap = dot3(along, boxes->middle);
    for (int i = 0; i < 3; i++)
        gap -= boxes->a[i] * fabs(along[i]) + boxes->b[i] * fabs(own[i]);
    return gap / sqrt(nearest->square);
}

/* Two boxes that do not meet: the nearest points are a corner and a point of the other, or on two
 * edges. */
static void apart(const Boxes *boxes, const Faces *faces, Nearest *nearest)
{
    double edges[12][3], point[3];
    const double *a = boxes->a, *b = boxes->b;
    const double *beyond_a = faces->of_first, *beyond_b = faces->of_second;
    bool of_b[12];
    for (int which = 0; which < 8; which++) {
        corner(b, which, point);
        if (can_be_nearest(point, -1, beyond_b))
            try_corner_of_second(boxes, which, nearest);
        corner(a, which, point);
        if (can_be_nearest(point, -1, beyond_a))
            try_corner_of_first(boxes, which, nearest);
    }
    for (int which = 0; which < 12; which++) {
        int axis = edge_middle(b, which, point);
        of_b[which] = can_be_nearest(point, axis, beyond_b);
        if (of_b[which])
            of_second(boxes, point, edges[which]);
    }
    for (int first = 0; first < 12; first++) {
        int axis = edge_middle(a, first, point);
        if (!can_be_nearest(point, axis, beyond_a))
            continue;
        for (int second = 0; second < 12; second++) {
            if (!of_b[second])
                continue;
            double away[3], reach = a[axis] + b[second >> 2];
            subtract3(edges[second], point, away);
            double far = dot3(away, away);
            /* No point of one edge is nearer to the other than their middles less half of both. */
            if (far > reach * reach && sqrt(far) - reach > sqrt(nearest->square))
                continue;
            try_edges(boxes, first, second, edges[second], nearest);
        }
    }
}

/* Largest separation of two boxes along the normals of faces and pairs of edges (Gottschalk, Lin
 * and Manocha 1996), its normal from the first to the second, and a point of the second. */
static double separating_axis(const double a[3], const double b[3], const double turned[9],
                              const double middle[3], double normal[3], double on_second[3])
{
    double most = -INFINITY;
    int kind = 0, edge_a = 0, edge_b = 0;
    for (int which = 0; which < 15; which++) {
        double axis[3] = {0.0, 0.0, 0.0};
        if (which < 3) {
            axis[which] = 1.0;
        } else if (which < 6) {
            for (int i = 0; i < 3; i++)
                axis[i] = turned[3 * i + which - 3];
        } else {
            double one[3] = {0.0, 0.0, 0.0};
            int first = (which - 6) / 3, second = (which - 6) % 3;
            one[first] = 1.0;
            const double other[3] = {turned[second], turned[3 + second], turned[6 + second]};
            cross3(one, other, axis);
            double size = norm3(axis);
            if (!(size > PARALLEL))
                continue;
            for (int i = 0; i < 3; i++)
                axis[i] /= size;
        }
        double away = dot3(axis, middle), gap = fabs(away), own[3];
        turn_back3(turned, axis, own);
        for (int i = 0; i < 3; i++)
            gap -= a[i] * fabs(axis[i]) + b[i] * fabs(own[i]);
        if (gap > most) {
            most = gap;
            kind = which < 3 ? 0 : which < 6 ? 1 : 2;
            edge_a = which < 6 ? 0 : (which - 6) / 3;
            edge_b = which < 6 ? 0 : (which - 6) % 3;
            for (int i = 0; i < 3; i++)
                normal[i] = away < 0.0 ? -axis[i] : axis[i];
        }
    }
    double own[3], point[3], moved[3];
    turn_back3(turned, normal, own);
    if (kind == 0) {
        for (int i = 0; i < 3; i++)
            point[i] = fabs(own[i]) > PARALLEL ? -copysign(b[i], own[i]) : 0.0;
    } else if (kind == 1) {
        double deepest[3], from[3];
        for (int i = 0; i < 3; i++)
            deepest[i] = fabs(normal[i]) > PARALLEL ? copysign(a[i], normal[i]) : 0.0;
        along3(deepest, most, normal, moved);
        subtract3(moved, middle, from);
        turn_back3(turned, from, point);
    } else {
        double low_a[3], high_a[3], low_b[3], high_b[3], on_a[3], on_b[3], from[3], to[3];
        for (int i = 0; i < 3; i++) {
            low_a[i] = high_a[i] = copysign(a[i], normal[i]);
            low_b[i] = high_b[i] = -copysign(b[i], own[i]);
        }
        low_a[edge_a] = -a[edge_a];
        high_a[edge_a] = a[edge_a];
        low_b[edge_b] = -b[edge_b];
        high_b[edge_b] = b[edge_b];
        turn3(turned, low_b, moved);
        along3(middle, 1.0, moved, from);
        turn3(turned, high_b, moved);
        along3(middle, 1.0, moved, to);
        segments(low_a, high_a, from, to, on_a, on_b);
        copy3(on_b, on_second);
        return most;
    }
    turn3(turned, point, moved);
    along3(middle, 1.0, moved, on_second);
    return most;
}

static void boxes(const Body *first, const Body *second, double far_m, Separation *out)
{
    double away[3], normal[3], on_second[3];
    Boxes both = {.a = first->half_m, .b = second->half_m};
    subtract3(second->position, first->position, away);
    turn_back3(first->rotation, away, both.middle);
    for (int row = 0; row < 3; row++)
        for (int column = 0; column < 3; column++) {
            double sum = 0.0;
            for (int i = 0; i < 3; i++)
                sum += first->rotation[3 * i + row] * second->rotation[3 * i + column];
            both.turned[3 * row + column] = sum;
        }
    Nearest nearest = {.square = INFINITY};
    bool known = false;
    if (out->features) {
        try_features(&both, out->features, &nearest);
        double distance = sqrt(nearest.square), gap = -INFINITY;
        if (distance > TOUCHING_M)
            gap = gap_along(&both, &nearest);
        if (gap > far_m) {
            out->distance_m = gap;
            return;
        }
        /* Nothing is nearer than what a plane between them leaves. */
        known = distance - gap <= ROUNDING * (distance + norm3(both.middle));
    }
    Faces faces;
    bool by_faces = true;
    if (!known) {
        between_faces(both.a, both.b, both.turned, both.middle, &faces);
        by_faces = faces.most > 0.0;
        double gap = faces.most;
        if (!by_faces)
            gap = separating_axis(both.a, both.b, both.turned, both.middle, normal, on_second);
        out->distance_m = gap;
        if (gap > far_m)
            return;
        out->features = 0;
        known = gap > 0.0;
        if (known)
            apart(&both, &faces, &nearest);
    }
    if (known) {
        double distance = sqrt(nearest.square);
        out->distance_m = distance;
        out->features = nearest.features;
        if (distance > TOUCHING_M)
            for (int i = 0; i < 3; i++)
                normal[i] = (nearest.on_second[i] - nearest.on_first[i]) / distance;
        else if (by_faces)
            separating_axis(both.a, both.b, both.turned, both.middle, normal, on_second);
        copy3(nearest.on_second, on_second);
    }
    turn3(first->rotation, normal, out->normal);
    turn3(first->rotation, on_second, away);
    along3(first->position, 1.0, away, out->point);
}

/* From a separation with first and second exchanged. */
static void exchange(Separation *out)
{
    along3(out->point, -out->distance_m, out->normal, out->point);
    for (int i = 0; i < 3; i++)
        out->normal[i] = -out->normal[i];
}

/* Of the balls around them: the bodies are no nearer. */
static double gap_at_least(const Body *first, const Body *second)
{
    if (first->kind == SHAPE_HALF_SPACE)
        return dot3(first->normal, second->middle) - first->offset_m - second->around_m;
    double between[3];
    subtract3(second->middle, first->middle, between);
    return norm3(between) - first->around_m - second->around_m;
}

void body_separation(const Body *first, const Body *second, double far_m, Separation *out)
{
    bool exchanged = false;
    /* In the order in which the functions above take them. */
    if (second->kind == SHAPE_HALF_SPACE ||
        (first->kind == SHAPE_BOX && second->kind == SHAPE_CAPSULE)) {
        const Body *swap = first;
        first = second;
        second = swap;
        exchanged = true;
    }
    out->distance_m = gap_at_least(first, second);
    if (out->distance_m > far_m)
        return;
    if (first->kind == SHAPE_HALF_SPACE) {
        if (second->kind == SHAPE_CAPSULE)
            plane_and_capsule(first, second, out);
        else
            plane_and_box(first, second, out);
    } else if (first->kind == SHAPE_CAPSULE) {
        if (second->kind == SHAPE_CAPSULE)
            capsules(first, second, out);
        else
            capsule_and_box(first, second, out);
    } else {
        boxes(first, second, far_m, out);
        return;
    }
    if (exchanged)
        exchange(out);
}
