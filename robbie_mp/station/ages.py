"""How old what is shown is, if that is worth a word."""


def silence(age_s: float | None, after_s: float) -> str:
    """Return how long a source has been silent, for people; '' if that is not longer than it may be.

    Args:
        age_s: of the newest that came; None: nothing has come yet.
        after_s: a source that lives has told something within this time.
    """
    if age_s is None or age_s <= after_s:
        return ""
    if age_s < 120:
        return f"{age_s:.0f} s"
    return f"{age_s / 60:.0f} min" if age_s < 7200 else f"{age_s / 3600:.0f} h"
