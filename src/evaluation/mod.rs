//! Solutions against truth: errors, availability, fix rates, plots.
