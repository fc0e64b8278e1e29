"""As much of the protocol of DDS (RTPS 2.3) as services need whose messages carry more than their bytes."""
