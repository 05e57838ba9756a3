"""What a run leaves behind: trace, record, report."""
