"""Exchange between robots over a network: headers, classes of traffic, counts, streams. See docs/link.md."""
