/* Plain loops that compilers vectorise, compiled for more than one instruction set: the best one that the processor has
 * is taken when the library is loaded. They give the same numbers, as nothing is contracted or reordered. */
#ifndef AUTOEXPOSE_VECTORISED_H
#define AUTOEXPOSE_VECTORISED_H

#include <stdlib.h> /* which defines __GLIBC__ */

#if defined(__x86_64__) && defined(__GLIBC__) && !defined(__clang__)
#define VECTORISED __attribute__((target_clones("avx2", "default")))
#else
#define VECTORISED
#endif

#endif
