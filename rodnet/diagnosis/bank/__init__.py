"""The candidates that come with rodnet, by group."""
