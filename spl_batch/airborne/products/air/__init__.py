"""Air that the filter takes for signal: fog, mist, layers and sheets of haze, which are told."""
