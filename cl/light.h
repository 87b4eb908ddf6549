// The plain light of pictures, for every rung.
#ifndef CLG_LIGHT_H
#define CLG_LIGHT_H

// Share of light that reaches a surface seen edge-on, and what a surface seen face-on sends back.
#define AMBIENT 0.1
#define ALBEDO 0.8

#endif
