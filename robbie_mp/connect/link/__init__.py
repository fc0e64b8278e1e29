"""Exchange between robots over a network: headers, classes of traffic, books, streams. See docs/link.md."""
