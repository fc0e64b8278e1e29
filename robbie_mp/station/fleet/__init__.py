"""Several robots on one page: what each tells of itself over the link, and a stop for all of them."""
