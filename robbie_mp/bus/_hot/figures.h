/* Two histograms of one kind of work; the same as WorkFigures in robbie_mp/bus/transport/histogram.py. */
#ifndef ROBBIE_FIGURES_H
#define ROBBIE_FIGURES_H

#include "layout.h"
#include "words.h"

/* Count one piece of work, how long it waited and how long it took, in the words from `at` on. */
void figures_record(shared_word *at, uint64_t waited_ns, uint64_t took_ns);

#endif
