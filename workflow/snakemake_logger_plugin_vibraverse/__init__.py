"""Snakemake's logger plugin ``vibraverse``: progress in place of five lines a job. What it shows is in ``console``.

Every start of Snakemake imports this, those inside jobs too, so everything else is imported when a run needs it.
"""

from dataclasses import dataclass, field
from typing import Optional

from snakemake_interface_logger_plugins.base import LogHandlerBase
from snakemake_interface_logger_plugins.settings import LogHandlerSettingsBase


@dataclass
class LogHandlerSettings(LogHandlerSettingsBase):
    """What a profile or command line sets: ``--logger-vibraverse-seconds``."""

    seconds: Optional[int] = field(  # noqa: UP045 - Snakemake knows no other spelling
        default=60, metadata={"help": "Seconds between two lines of progress where no terminal shows bars"}
    )


class LogHandler(LogHandlerBase):
    """Shows a run's progress; everything else as Snakemake does."""

    def __post_init__(self) -> None:
        from vibraverse.machine.console import Console

        self._console = Console(self.common_settings, self.settings.seconds or 60)

    def emit(self, record) -> None:
        """Show a record, at once or as part of the progress."""
        try:
            self._console.take(record)
        except (OSError, ValueError):  # the terminal is gone, or a product is damaged: not the run's concern
            self.handleError(record)

    def close(self) -> None:
        """Show what the run made; Snakemake closes a handler twice."""
        self._console.close()
        super().close()

    @property
    def writes_to_stream(self) -> bool:
        """Whether this takes the place of Snakemake's own lines."""
        return True

    @property
    def writes_to_file(self) -> bool:
        """Whether this writes a file: Snakemake's own log keeps everything."""
        return False

    @property
    def has_filter(self) -> bool:
        """Whether this chooses by itself what is shown."""
        return True

    @property
    def has_formatter(self) -> bool:
        """Whether this writes the lines by itself."""
        return True

    @property
    def needs_rulegraph(self) -> bool:
        """Whether this wants the graph of rules."""
        return False
