"""Checks signed addresses of S3 requests by Amazon's own code.

Usage: signatures.py SECRET < requests, a line each: METHOD ADDRESS
Prints how many have the signature that botocore computes with this secret.
"""

import sys
from urllib.parse import parse_qsl, urlsplit

from botocore.auth import S3SigV4QueryAuth
from botocore.awsrequest import AWSRequest
from botocore.credentials import Credentials

right = 0
for line in sys.stdin:
    method, address = line.split()
    fields = dict(parse_qsl(urlsplit(address).query, keep_blank_values=True))
    key, _day, region, service, _end = fields["X-Amz-Credential"].split("/")
    assert fields["X-Amz-SignedHeaders"] == "host", line
    auth = S3SigV4QueryAuth(Credentials(key, sys.argv[1]), service, region)
    unsigned = address.replace("&X-Amz-Signature=" + fields["X-Amz-Signature"], "")
    assert unsigned != address, line
    request = AWSRequest(method=method, url=unsigned)
    request.context["timestamp"] = fields["X-Amz-Date"]
    to_sign = auth.string_to_sign(request, auth.canonical_request(request))
    right += auth.signature(to_sign, request) == fields["X-Amz-Signature"]
print(right)
