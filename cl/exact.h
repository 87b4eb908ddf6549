// A ray and a triangle in integers: the caller's ray, the mesh's own vertices, no rounding. What is zero is
// decided as if the origin were moved by (e, e^2, e^3), e an infinitesimal (Edelsbrunner & Mucke 1990), so that
// a ray crosses just one of the triangles that share an edge or vertex, or as many as it must.
#ifndef CLG_EXACT_H
#define CLG_EXACT_H
#include "big.h"
#include "mesh.h"

typedef struct {
    int unit, direction_unit; // what 1 stands for: 2^unit local units, 2^direction_unit of the direction
    Big direction[3];
    Big corner[3][3];         // relative to the caller's origin
    Big edge[3];              // direction . (p x q) for the edge p q that is opposite of a corner
    Big over, under;          // t = over / under
} Exact;

// The unit in which the corners and the origin are integers.
int unit_of(const Ray *ray, const Corners *corners)
{
    int unit = INT_MAX;
    for (int a = 0; a < 3; ++a) {
        if (ray->caller_origin[a] != 0.0)
            unit = min(unit, lowest_bit(ray->caller_origin[a]) - ray->frame_exponent);
        for (int i = 0; i < 3; ++i)
            unit = min(unit, lowest_bit(corners->at[i][a] + ray->offset[a]));
    }
    return unit == INT_MAX ? 0 : unit;
}

// r = p q - s t
OUT_OF_LINE
void big_cross(Big *r, const Big *p, const Big *q, const Big *s, const Big *t)
{
    Big left, right;
    big_multiply(&left, p, q);
    big_multiply(&right, s, t);
    big_add(r, &left, -1, &right);
}

// r = a . (p x q)
OUT_OF_LINE
void big_determinant(Big *r, const Big *a, const Big *p, const Big *q)
{
    Big cross, product, sum;
    r->sign = 0;
    r->count = 0;
    for (int x = 0; x < 3; ++x) {
        const int y = x < 2 ? x + 1 : 0, z = y < 2 ? y + 1 : 0;
        big_cross(&cross, &p[y], &q[z], &p[z], &q[y]);
        big_multiply(&product, &a[x], &cross);
        big_add(&sum, r, 1, &product);
        big_copy(r, &sum);
    }
}

OUT_OF_LINE
void set_exact(Exact *e, const Ray *ray, const Corners *corners, int unit)
{
    Big vertex, origin;
    e->unit = unit;
    e->direction_unit = min(min(lowest_bit(ray->caller_direction[0]), lowest_bit(ray->caller_direction[1])),
                            lowest_bit(ray->caller_direction[2]));
    for (int a = 0; a < 3; ++a) {
        big_of(&e->direction[a], ray->caller_direction[a], -e->direction_unit);
        big_of(&origin, ray->caller_origin[a], -ray->frame_exponent - unit);
        for (int i = 0; i < 3; ++i) {
            big_of(&vertex, corners->at[i][a] + ray->offset[a], -unit);
            big_add(&e->corner[i][a], &vertex, -1, &origin);
        }
    }
    for (int i = 0; i < 3; ++i) {
        const int j = i < 2 ? i + 1 : 0, k = j < 2 ? j + 1 : 0;
        big_determinant(&e->edge[i], e->direction, e->corner[j], e->corner[k]);
    }
    big_add(&vertex, &e->edge[0], 1, &e->edge[1]);
    big_add(&e->under, &vertex, 1, &e->edge[2]);
    big_determinant(&e->over, e->corner[0], e->corner[1], e->corner[2]);
}

// The sign of component a of p x q.
OUT_OF_LINE
int cross_sign(const Big *p, const Big *q, int a)
{
    Big r;
    const int b = a < 2 ? a + 1 : 0, c = b < 2 ? b + 1 : 0;
    big_cross(&r, &p[b], &q[c], &p[c], &q[b]);
    return r.sign;
}

// q - p, for corners j and k.
void edge_vector(const Exact *e, int j, int k, Big *vector)
{
    for (int a = 0; a < 3; ++a)
        big_add(&vector[a], &e->corner[k][a], -1, &e->corner[j][a]);
}

// The sign of the edge function opposite of corner i for the moved origin: the function changes by
// move . (direction x edge). Never 0 unless the edge is parallel to the ray.
OUT_OF_LINE
int edge_sign(const Exact *e, int i)
{
    if (e->edge[i].sign != 0)
        return e->edge[i].sign;
    const int j = i < 2 ? i + 1 : 0, k = j < 2 ? j + 1 : 0;
    Big edge[3];
    edge_vector(e, j, k, edge);
    int sign = 0;
    for (int a = 0; a < 3 && sign == 0; ++a)
        sign = cross_sign(e->direction, edge, a);
    return sign;
}

// Whether the line through the moved origin crosses the triangle.
bool crossed(const Exact *e)
{
    if (e->under.sign == 0)
        return false;
    const int sign = edge_sign(e, 0);
    return sign != 0 && edge_sign(e, 1) == sign && edge_sign(e, 2) == sign;
}

// The local t, counted from where the ray was moved to.
OUT_OF_LINE
double local_t(const Exact *e, const Ray *ray)
{
    const int exponent = e->unit - e->direction_unit - ray->length_exponent;
    if (ray->t_entry == 0.0)
        return quotient(&e->over, &e->under, exponent);
    Big entry, before, t;
    const int bit = lowest_bit(ray->t_entry), least = min(bit, exponent);
    big_of(&entry, ray->t_entry, -bit);
    big_multiply(&before, &entry, &e->under);
    big_shift(&before, (uint)(bit - least));
    big_copy(&entry, &e->over);
    big_shift(&entry, (uint)(exponent - least));
    big_add(&t, &entry, -1, &before);
    return quotient(&t, &e->under, least);
}

// The sign of t - bound, in the caller's lengths. The bound is finite.
OUT_OF_LINE
int compare_with_bound(const Exact *e, const Ray *ray, double bound)
{
    const int exponent = e->unit - e->direction_unit + ray->frame_exponent;
    const int bit = bound == 0.0 ? exponent : lowest_bit(bound), least = min(bit, exponent);
    Big number, left, right;
    big_of(&number, bound, -bit);
    big_multiply(&right, &number, &e->under);
    big_shift(&right, (uint)(bit - least));
    big_copy(&left, &e->over);
    big_shift(&left, (uint)(exponent - least));
    return big_compare(&left, &right) * e->under.sign;
}

// Whether the moved origin lies before the plane, where the origin itself lies in it: t changes by
// - move . normal / under.
OUT_OF_LINE
bool starts_before(const Exact *e)
{
    Big first[3], second[3];
    edge_vector(e, 0, 1, first);
    edge_vector(e, 0, 2, second);
    int sign = 0;
    for (int a = 0; a < 3 && sign == 0; ++a)
        sign = cross_sign(first, second, a);
    return sign == -e->under.sign;
}

// The sign of t - t of the other, which has the same units.
OUT_OF_LINE
int compare_t(const Exact *e, const Exact *other)
{
    Big left, right;
    big_multiply(&left, &e->over, &other->under);
    big_multiply(&right, &other->over, &e->under);
    return big_compare(&left, &right) * e->under.sign * other->under.sign;
}

#endif
