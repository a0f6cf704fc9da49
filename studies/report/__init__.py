"""Reports: one page of HTML that says what runs, studies and sweeps have found, with nothing to be fetched."""
