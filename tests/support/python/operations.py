"""Google's own client for operations that take long, google-api-core, over batch jobs; its messages are those
of googleapis-common-protos, the results' are generated from proto/.

Usage: operations.py STUBS HOST:PORT GOOD BAD CANCELLED
GOOD is a job that succeeds, BAD one that fails, CANCELLED one that takes long. Prints one JSON object.
"""

import json
import sys

stubs, server, good, bad, cancelled = sys.argv[1:6]
sys.path.insert(0, stubs)

import grpc
from google.api_core import exceptions, operation, operations_v1
from google.longrunning import operations_pb2, operations_pb2_grpc
from google.rpc import error_details_pb2
from graphfix.v1 import jobs_pb2

channel = grpc.insecure_channel(server)
client = operations_v1.OperationsClient(channel)
stub = operations_pb2_grpc.OperationsStub(channel)


def future(job):
    """Polls until the job has ended."""
    begun = client.get_operation(job)
    return operation.from_gapic(begun, client, jobs_pb2.JobReport, metadata_type=jobs_pb2.Job)


def reason(failure):
    """The stable code among the details of a failure."""
    info = error_details_pb2.ErrorInfo()
    return next(info.reason for detail in failure.errors[0].details if detail.Unpack(info))


client.cancel_operation(cancelled)
succeeds = future(good)
report = succeeds.result(timeout=120)
metadata = succeeds.metadata
failure = future(bad).exception(timeout=120)
stopped = future(cancelled)
waited = stub.WaitOperation(operations_pb2.WaitOperationRequest(name=good))
listed = [job.name for job in client.list_operations("", 'metadata.state = "SUCCEEDED"')]
client.delete_operation(good)
try:
    client.get_operation(good)
    gone = None
except exceptions.NotFound as error:
    gone = error.reason
print(
    json.dumps(
        {
            "epochs": report.epochs,
            "state": metadata.state,
            "failure": [failure.grpc_status_code.name, reason(failure)],
            "cancelled": stopped.cancelled(),
            "waited": waited.done,
            "listed": listed,
            "gone": gone,
        }
    )
)
