"""The report: a page that shows the dataset and plays its sounds."""
