/* What information.py says of noise, blur and front ends. */
#ifndef AUTOEXPOSE_NOISE_H
#define AUTOEXPOSE_NOISE_H

#define FRONT_END_DN 6.0
#define BLUR_PX 5.0
#define QUANTISATION (1.0 / 12.0)

static inline double variance_of(double noise, double pixels)
{
    const double averaged = (noise + QUANTISATION) / pixels;
    return pixels > 1.0 ? averaged + QUANTISATION : averaged;
}

#endif
