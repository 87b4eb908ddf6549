"""Pictures in stages, each a kernel over all pixels of a tile: rays, hits, surfaces, lights, sky, sums.

``renderer`` draws what one kernel can, and comes here for the rest. Rays are cast by the kernels that arrays
of rays are cast by; what is here makes rays and takes hits. ``staged`` is the way of a picture.
"""
