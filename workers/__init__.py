"""The stock robot's algorithms. They do not depend on messages, modules or hardware."""
