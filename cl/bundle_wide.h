// What the rays of a bundle keep of a triangle on the wide rungs: what decides for one ray (triangle.h), four rays at
// a time; where that would have to look closer, one by one. Part of bundle_keep.h.
#ifndef CLG_BUNDLE_WIDE_H
#define CLG_BUNDLE_WIDE_H

// Corner i along the bundle's axis: its exact coordinate.
double on_axis(const Corners *corners, uint i, int axis)
{
    return corners->at[i][axis];
}

Sheared4 sheared_by_4(const Tile *tile, const Bundle *bundle, uint k, const Corners *corners)
{
    const int ku = bundle->way.ku, kv = bundle->way.kv, kd = bundle->way.kd;
    const double4 ou = vload4(0, tile->o[ku] + k), ov = vload4(0, tile->o[kv] + k), od = vload4(0, tile->o[kd] + k);
    const double4 su = vload4(0, bundle->shear[0] + k), sv = vload4(0, bundle->shear[1] + k);
    Sheared4 p;
    p.az = on_axis(corners, 0, kd) - od;
    p.bz = on_axis(corners, 1, kd) - od;
    p.cz = on_axis(corners, 2, kd) - od;
    p.ax = (on_axis(corners, 0, ku) - ou) - su * p.az;
    p.ay = (on_axis(corners, 0, kv) - ov) - sv * p.az;
    p.bx = (on_axis(corners, 1, ku) - ou) - su * p.bz;
    p.by = (on_axis(corners, 1, kv) - ov) - sv * p.bz;
    p.cx = (on_axis(corners, 2, ku) - ou) - su * p.cz;
    p.cy = (on_axis(corners, 2, kv) - ov) - sv * p.cz;
    return p;
}

// Which of the crossings are in the rays' intervals and, unless any will do, nearer than what they have.
#ifdef RUNG_EXACT
long4 taken_of_4(const Tile *tile, uint k, uint id, Crossings *c)
{
    const double4 entry = vload4(0, tile->t_entry + k), unit = vload4(0, tile->t_unit + k);
    const double4 t_min = vload4(0, tile->t_min + k), t_max = vload4(0, tile->t_max + k);
    // scene_t and scene_t_error.
    const double4 at = (entry + c->t) * unit;
    const double4 off = (c->error + 0x1p-51 * fabs(entry + c->t)) * unit * (1.0 + 0x1p-40) + 0x1p-1074;
    const long4 inside = (at - off > t_min) & (at + off < t_max);
    const long4 outside = (at + off < t_min) | (at - off > t_max);
#ifdef QUERY_ANY
    c->unsure |= c->met & ~inside & ~outside;
    return c->met & inside;
#else
    const double4 t = vload4(0, tile->t + k), error = vload4(0, tile->errors + k);
    const long4 first = convert_long4(vload4(0, tile->ids + k) == NO_HIT) | (c->t + c->error < t - error);
    const long4 later = ~first & (c->t - c->error > t + error);
    c->unsure |= c->met & ~outside & ~later & ~(inside & first);
    return c->met & inside & first;
#endif
}
#else
long4 taken_of_4(const Tile *tile, uint k, uint id, Crossings *c)
{
    const double4 entry = vload4(0, tile->t_entry + k), unit = vload4(0, tile->t_unit + k);
    const double4 scene = (entry + c->t) * unit;
    const long4 taken = c->met & (scene >= vload4(0, tile->t_min + k)) & (scene <= vload4(0, tile->t_max + k));
#ifdef QUERY_ANY
    return taken;
#else
    const double4 least = (entry + vload4(0, tile->t + k)) * unit;
    return taken & ((scene < least) | ((scene == least) & convert_long4((uint4)(id) < vload4(0, tile->ids + k))));
#endif
}
#endif

// keep, for rays k .. k + 3.
void keep_of_4(Tile *tile, Bundle *bundle, uint k, int4 open, const Corners *corners, uint id, MESH_PARAMETERS)
{
    const Sheared4 sheared = sheared_by_4(tile, bundle, k, corners);
    Crossings c = crossings_of(&sheared, vload4(0, bundle->shear[2] + k), convert_long4(open));
    const int4 taken = convert_int4(taken_of_4(tile, k, id, &c)) & open;
    const int4 unsure = convert_int4(c.unsure) & open;
    const long4 wide = convert_long4(taken);
    vstore4(wide ? c.t : vload4(0, tile->t + k), 0, tile->t + k);
    vstore4(taken ? (uint4)(id) : vload4(0, tile->ids + k), 0, tile->ids + k);
#ifdef RUNG_EXACT
    vstore4(wide ? c.error : vload4(0, tile->errors + k), 0, tile->errors + k);
    for (ulong lanes = bits_of_4(wide); lanes != 0; lanes &= lanes - 1)
        tile->corners[k + lowest_of_64(lanes)] = *corners;
    tile->certain |= bits_of_4(wide) << k;
#endif
    if (!any(unsure))
        return;
    for (ulong lanes = bits_of_4(convert_long4(unsure)); lanes != 0; lanes &= lanes - 1) {
        const uint own = k + lowest_of_64(lanes);
        const Ray ray = ray_of(tile, own);
        const Projection projection = projection_of(&ray);
        Hit hit = hit_of(tile, own);
        keep(&ray, &projection, MESH_ARGUMENTS, id, &hit);
        set_hit(tile, own, hit);
    }
}

void keep_of_lanes(Tile *tile, Bundle *bundle, uint g, const Seen *seen, int8 open, uint id, MESH_PARAMETERS)
{
    const Corners corners = corners_of(id, MESH_ARGUMENTS);
    const uint k = g * LANES;
    if (any(open.lo))
        keep_of_4(tile, bundle, k, open.lo, &corners, id, MESH_ARGUMENTS);
    if (any(open.hi))
        keep_of_4(tile, bundle, k + 4, open.hi, &corners, id, MESH_ARGUMENTS);
#ifdef QUERY_ANY
    bundle->last[g] = vload8(0, tile->ids + k) == NO_HIT ? bundle->last[g] : (float8)(-INFINITY);
#else
    bundle->last[g] = min(bundle->last[g], eight_of(tile->t + k) + bundle->slack[g]);
#endif
#ifdef RUNG_EXACT
    const int8 many = vload8(0, tile->decisions + k) > MOST_DECISIONS(tile->triangle_count);
    if (any(many)) {
        tile->alone |= (ulong)bits_of(many) << k & bundle->members;
        bundle->last[g] = many ? (float8)(-INFINITY) : bundle->last[g];
    }
#endif
}

#endif
