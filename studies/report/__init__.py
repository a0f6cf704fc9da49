"""Reports: one offline HTML page on runs, studies and sweeps."""
