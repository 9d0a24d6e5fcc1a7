"""Reports of evaluations: terminal tables, JSON, CSV, Markdown, JUnit and MCAP."""
