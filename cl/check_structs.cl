// Sizes and member offsets of every shared struct, as this device compiles them.
// offsets: one uint per entry of CLG_STRUCTS, the list that clgrid/structs.py makes from its table.

#define STORE_SIZE(type) offsets[entry++] = (uint)sizeof(type);
#define STORE_OFFSET(type, member)                                            \
    {                                                                         \
        type instance;                                                        \
        offsets[entry++] = (uint)((__private char *)&instance.member - (__private char *)&instance); \
    }

__kernel __attribute__((reqd_work_group_size(1, 1, 1))) void check_structs(__global uint *offsets) {
    int entry = 0;
    CLG_STRUCTS(STORE_SIZE, STORE_OFFSET)
}
