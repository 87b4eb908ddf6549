// QUERY_ALL: the hits of a ray, one after another from `begin` on, as far as there is room before `end`.
//   t, ids        reported t, triangle
//   uvs, t_errs   WITH_UVS: weights; WITH_T_ERR, which `exact` always has: the error of t
#ifndef CLG_RECORDS_H
#define CLG_RECORDS_H

typedef struct {
    __global double *t;
    __global uint *ids;
#ifdef WITH_UVS
    __global real *uvs;
#endif
#ifdef WITH_T_ERR
    __global double *t_errs;
#endif
    ulong begin, end;
} Records;

// Keeps a meeting as the ray's hit number n.
void record(const Records *r, const Ray *ray, const Projection *projection, MESH_PARAMETERS, uint id,
            const Meeting *meeting, uint n)
{
    const ulong at = r->begin + n;
    if (at >= r->end)
        return;
    r->t[at] = reported_t(ray, meeting);
    r->ids[at] = id;
#if defined(WITH_UVS) || defined(WITH_T_ERR)
    real weights[2] = {0, 0};
    double error = 0.0;
    describe(ray, projection, MESH_ARGUMENTS, id, meeting, weights, &error);
#ifdef WITH_UVS
    r->uvs[2 * at] = weights[0];
    r->uvs[2 * at + 1] = weights[1];
#endif
#ifdef WITH_T_ERR
    r->t_errs[at] = error;
#endif
#endif
}

// Whether hit i comes before hit j: by t, then by triangle.
bool comes_before(const Records *r, const Ray *ray, MESH_PARAMETERS, ulong i, ulong j)
{
#ifdef RUNG_EXACT
    if (r->t[i] + r->t_errs[i] < r->t[j] - r->t_errs[j])
        return true;
    if (r->t[i] - r->t_errs[i] > r->t[j] + r->t_errs[j])
        return false;
    const Corners a = corners_of(r->ids[i], MESH_ARGUMENTS), b = corners_of(r->ids[j], MESH_ARGUMENTS);
    const int order = compare_exactly(ray, &a, &b);
    return order < 0 || (order == 0 && r->ids[i] < r->ids[j]);
#else
    return r->t[i] < r->t[j] || (r->t[i] == r->t[j] && r->ids[i] < r->ids[j]);
#endif
}

void exchange(const Records *r, ulong i, ulong j)
{
    const double t = r->t[i];
    r->t[i] = r->t[j];
    r->t[j] = t;
    const uint id = r->ids[i];
    r->ids[i] = r->ids[j];
    r->ids[j] = id;
#ifdef WITH_UVS
    for (ulong k = 0; k < 2; ++k) {
        const real weight = r->uvs[2 * i + k];
        r->uvs[2 * i + k] = r->uvs[2 * j + k];
        r->uvs[2 * j + k] = weight;
    }
#endif
#ifdef WITH_T_ERR
    const double error = r->t_errs[i];
    r->t_errs[i] = r->t_errs[j];
    r->t_errs[j] = error;
#endif
}

// Lets hit i sink in the heap of the first `count`: no hit comes before those below it.
void sink(const Records *r, const Ray *ray, MESH_PARAMETERS, ulong i, ulong count)
{
    for (ulong child = 2 * i + 1; child < count; child = 2 * i + 1) {
        if (child + 1 < count
            && comes_before(r, ray, MESH_ARGUMENTS, r->begin + child, r->begin + child + 1))
            ++child;
        if (!comes_before(r, ray, MESH_ARGUMENTS, r->begin + i, r->begin + child))
            return;
        exchange(r, r->begin + i, r->begin + child);
        i = child;
    }
}

// Sorts the ray's hits, which are in the order of cells: nearly sorted already, unless a cell holds many.
void sort_records(const Records *r, const Ray *ray, MESH_PARAMETERS, ulong count)
{
    ulong sorted = 1;
    while (sorted < count
           && !comes_before(r, ray, MESH_ARGUMENTS, r->begin + sorted, r->begin + sorted - 1))
        ++sorted;
    if (sorted < count && count <= 64) {
        for (ulong i = sorted; i < count; ++i)
            for (ulong j = r->begin + i;
                 j > r->begin && comes_before(r, ray, MESH_ARGUMENTS, j, j - 1); --j)
                exchange(r, j, j - 1);
    } else if (sorted < count) {
        for (ulong i = count / 2; i-- > 0;)
            sink(r, ray, MESH_ARGUMENTS, i, count);
        for (ulong left = count - 1; left > 0; --left) {
            exchange(r, r->begin, r->begin + left);
            sink(r, ray, MESH_ARGUMENTS, 0, left);
        }
    }
}

#endif
