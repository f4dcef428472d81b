"""Media: audio files, spectrograms and pictures."""
