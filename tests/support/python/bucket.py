"""A bucket of an S3 service, by Amazon's own client.

Usage: bucket.py ENDPOINT create|keys|parts|get|put|delete [NAME [FILE]]
`keys` prints the names of all objects, `parts` the number of uploads in parts that have not ended,
`get` writes an object to the standard output, `put` replaces it by a file.
"""

import sys

import boto3

endpoint, command, *arguments = sys.argv[1:]
client = boto3.client(
    "s3",
    endpoint_url=endpoint,
    region_name="us-east-1",
    aws_access_key_id="an-id",
    aws_secret_access_key="a-secret",
)
bucket = {"Bucket": "jobs"}
if command == "create":
    client.create_bucket(**bucket)
elif command == "keys":
    for page in client.get_paginator("list_objects_v2").paginate(**bucket):
        for found in page.get("Contents", []):
            print(found["Key"])
elif command == "parts":
    print(len(client.list_multipart_uploads(**bucket).get("Uploads", [])))
elif command == "get":
    sys.stdout.buffer.write(client.get_object(**bucket, Key=arguments[0])["Body"].read())
elif command == "put":
    with open(arguments[1], "rb") as file:
        client.put_object(**bucket, Key=arguments[0], Body=file)
elif command == "delete":
    client.delete_object(**bucket, Key=arguments[0])
else:
    sys.exit(f"unknown command {command}")
