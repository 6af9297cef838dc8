"""The report of a finding: HTML, JSON and figures; it draws and simulates nothing."""
