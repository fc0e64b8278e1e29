"""A module that has a secret."""

import hashlib

from robbie_mp import REQUIRED, Module, Secret, setting
from robbie_mp.messages import Mark


class Keeper(Module):
    """Shows that it knows the secret by its hash; then fails once, so that there is a crash report."""

    key: Secret = setting(REQUIRED, "what nobody else may know")
    word: str = setting("", "what everybody may know", changeable=True)
    period_s = 0.05

    def setup(self) -> None:
        self.count = self.restored or 0
        (self.output_directory / "hash.txt").write_text(
            hashlib.sha256(self.key.reveal().encode()).hexdigest()
        )

    def tick(self) -> None:
        self.count += 1
        self.checkpoint(self.count)
        self.log.info("the setting is %s, %r", self.key, self.key)
        self.publish(Mark(text=f"{self.key} {self.key!r}"))
        if self.count == 3:
            raise RuntimeError(f"a failure with {self.key!r}, {vars(self)}")
