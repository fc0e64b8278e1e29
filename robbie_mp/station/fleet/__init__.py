"""Several robots on one page: the summary that each sends over the link, and a stop for all of them."""
