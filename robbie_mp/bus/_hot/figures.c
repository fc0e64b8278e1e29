/* Counting durations in histograms. */
#include "figures.h"

static unsigned bucket_of(uint64_t ns)
{
    const uint64_t units = ns >> UNIT_BITS;
    const int bits = units == 0 ? 0 : 64 - __builtin_clzll(units);
    const int shift = bits - (PARTS_BITS + 1);
    return shift > 0 ? (unsigned)(shift << PARTS_BITS) + (unsigned)(units >> shift) : (unsigned)units;
}

static void count(shared_word *at, uint64_t ns)
{
    if (ns > MAX_TIME_NS)
        ns = MAX_TIME_NS;
    shared_word *bucket = at + BUCKETS + bucket_of(ns);
    store(bucket, load(bucket) + 1);
    store(at + SUM_NS, load(at + SUM_NS) + ns);
    if (ns > load(at + MAX_NS))
        store(at + MAX_NS, ns);
}

void figures_record(shared_word *at, uint64_t waited_ns, uint64_t took_ns)
{
    count(at, waited_ns);
    count(at + HISTOGRAM_WORDS, took_ns);
}
