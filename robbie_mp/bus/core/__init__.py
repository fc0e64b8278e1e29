"""The router: routing, queues, handle table, recovery."""
