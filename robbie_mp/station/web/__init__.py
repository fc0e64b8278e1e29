"""Who may connect: sockets, sessions, roles and limits; everything that a stranger can reach."""
