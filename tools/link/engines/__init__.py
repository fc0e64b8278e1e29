"""Other engines under the trial of links: what a link brings beside them."""
