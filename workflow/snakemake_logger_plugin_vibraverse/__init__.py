"""Snakemake's logger plugin ``vibraverse``: progress in place of five lines per job; ``console`` holds its output.

Every start of Snakemake imports this module, also inside jobs, so everything else is imported when a run needs it.
"""

from dataclasses import dataclass, field
from typing import Optional

from snakemake_interface_logger_plugins.base import LogHandlerBase
from snakemake_interface_logger_plugins.settings import LogHandlerSettingsBase


@dataclass
class LogHandlerSettings(LogHandlerSettingsBase):
    """Settings of a profile or command line: ``--logger-vibraverse-seconds``."""

    seconds: Optional[int] = field(  # noqa: UP045 - Snakemake knows no other spelling
        default=60, metadata={"help": "Seconds between two lines of progress where no terminal shows bars"}
    )


class LogHandler(LogHandlerBase):
    """The handler that shows a run's progress, and everything else as Snakemake does."""

    def __post_init__(self) -> None:
        from vibraverse.machine.console import Console

        self._console = Console(self.common_settings, self.settings.seconds or 60)

    def emit(self, record) -> None:
        """Show a log record, at once or as part of the progress."""
        try:
            self._console.take(record)
        except (OSError, ValueError):  # a closed terminal or a damaged product must not stop the run
            self.handleError(record)

    def close(self) -> None:
        """Print the summary of the run; Snakemake closes a handler twice."""
        self._console.close()
        super().close()

    @property
    def writes_to_stream(self) -> bool:
        """Whether this replaces Snakemake's own output."""
        return True

    @property
    def writes_to_file(self) -> bool:
        """Whether this writes a file; it does not, because Snakemake's own log keeps everything."""
        return False

    @property
    def has_filter(self) -> bool:
        """Whether this filters records by itself."""
        return True

    @property
    def has_formatter(self) -> bool:
        """Whether this formats records by itself."""
        return True

    @property
    def needs_rulegraph(self) -> bool:
        """Whether this needs the graph of rules."""
        return False
