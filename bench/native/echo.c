/*
 * Lower bound for an EGM client in C: it sends back the received datagram. It stands in for ABB's
 * own library, which also decodes, computes and encodes.
 *
 *     echo PORT      prints READY, and ends after 20 s without a datagram
 */
#include <arpa/inet.h>
#include <stdio.h>
#include <stdlib.h>
#include <sys/socket.h>
#include <sys/time.h>

int main(int count, char **words)
{
    char data[2048];
    struct sockaddr_in address = {.sin_family = AF_INET};
    struct timeval idle = {.tv_sec = 20};
    int port = count == 2 ? atoi(words[1]) : 0;
    int sock = socket(AF_INET, SOCK_DGRAM, 0);
    address.sin_port = htons((uint16_t)port);
    address.sin_addr.s_addr = htonl(INADDR_LOOPBACK);
    if (sock < 0 || bind(sock, (struct sockaddr *)&address, sizeof address) ||
        setsockopt(sock, SOL_SOCKET, SO_RCVTIMEO, &idle, sizeof idle)) {
        perror("echo");
        return 1;
    }
    puts("READY");
    fflush(stdout);
    for (;;) {
        socklen_t length = sizeof address;
        ssize_t size = recvfrom(sock, data, sizeof data, 0, (struct sockaddr *)&address, &length);
        if (size < 0)
            return 0;
        sendto(sock, data, (size_t)size, 0, (struct sockaddr *)&address, length);
    }
}
