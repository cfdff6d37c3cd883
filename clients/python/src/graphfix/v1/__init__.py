"""Messages and stubs of the service's calls, generated from `proto/graphfix/v1`."""
