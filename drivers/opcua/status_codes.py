"""Kinds of OPC UA status codes (OPC UA Part 4 and 6)."""

from asyncua.ua.status_codes import StatusCodes

DENIED = frozenset(
    {
        StatusCodes.BadUserAccessDenied,
        StatusCodes.BadNotWritable,
        StatusCodes.BadNotReadable,
        StatusCodes.BadIdentityTokenInvalid,
        StatusCodes.BadIdentityTokenRejected,
    }
)
TOO_MANY = StatusCodes.BadTooManyOperations
UNKNOWN_NODE = frozenset(
    {
        StatusCodes.BadNodeIdUnknown,
        StatusCodes.BadNodeIdInvalid,
        StatusCodes.BadAttributeIdInvalid,
    }
)
LOST = frozenset(
    {
        StatusCodes.BadSessionIdInvalid,
        StatusCodes.BadSessionClosed,
        StatusCodes.BadSessionNotActivated,
        StatusCodes.BadSecureChannelClosed,
        StatusCodes.BadSecureChannelIdInvalid,
        StatusCodes.BadSecureChannelTokenUnknown,
        StatusCodes.BadSecurityChecksFailed,
        StatusCodes.BadSequenceNumberInvalid,
        StatusCodes.BadConnectionClosed,
        StatusCodes.BadServerHalted,
        StatusCodes.BadShutdown,
        StatusCodes.BadTcpInternalError,
        StatusCodes.BadTcpMessageTypeInvalid,
        StatusCodes.BadTcpNotEnoughResources,
        StatusCodes.BadTcpSecureChannelUnknown,
        StatusCodes.BadTcpServerTooBusy,
    }
)
"""In an open session: the session, its channel or its connection is no more."""
CERTIFICATE = frozenset(
    {
        StatusCodes.BadSecurityChecksFailed,
        StatusCodes.BadSecurityPolicyRejected,
        StatusCodes.BadSecurityModeRejected,
        *(code for name, code in vars(StatusCodes).items() if name.startswith("BadCertificate")),
    }
)
