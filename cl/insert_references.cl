// Build, stage 4: one slab becomes a finished piece of the compact grid, by the paper's count, prefix
// sum and reverse insertion (Lagae & Dutre 2008, section 3): one array is counter, end, then start.
// Walking backwards while the pointers descend leaves every list ascending.
__attribute__((reqd_work_group_size(1, 1, 1)))
__kernel void insert_references(uint cell_count, uint slab_shift, __global const uint *slab_starts,
                                __global const ushort *binned_cells,
                                __global const uint *binned_triangles, __global uint *cells,
                                __global uint *references)
{
    const uint slab = get_global_id(0);
    const uint first = slab << slab_shift;
    const uint size = min(cell_count - first, 1u << slab_shift);
    const uint begin = slab_starts[slab], end = slab_starts[slab + 1];
    __global uint *cell = cells + first;
    for (uint i = 0; i < size; ++i)
        cell[i] = 0;
    for (uint r = begin; r < end; ++r)
        ++cell[binned_cells[r]];
    uint sum = begin;
    for (uint i = 0; i < size; ++i) {
        sum += cell[i];
        cell[i] = sum;
    }
    for (uint r = end; r > begin; --r)
        references[--cell[binned_cells[r - 1]]] = binned_triangles[r - 1];
    if (first + size == cell_count)
        cell[size] = end;
}
