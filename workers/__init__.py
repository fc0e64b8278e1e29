"""The stock robot's algorithms: they know nothing of messages, modules or hardware."""
