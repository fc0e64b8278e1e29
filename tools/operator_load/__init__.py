"""What the operator's page costs a robot with large maps, cameras and clouds, and how often it is drawn."""

ROLES = ("operator", "observer")


def token_of(role: str) -> str:
    """Return what an operator or observer logs in with."""
    return f"{role}-of-the-loaded-robot"
