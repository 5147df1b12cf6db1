/* A client of `boresight serve SCENARIO --tcp PORT` in C11 and POSIX sockets, without other libraries.
 *
 * It sends attitudes of a camera that turns slowly, in lockstep: each makes one frame, whose solution is read and
 * compared with the attitude that was sent.
 *
 *     cc -std=c11 -Wall -Wextra -o client client.c -lm && ./client 127.0.0.1 7001 20
 */
#define _POSIX_C_SOURCE 200809L
#include <math.h>
#include <netdb.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/socket.h>
#include <unistd.h>

static const double PI = 3.14159265358979323846;
static FILE *to_server, *from_server;
static char *line; /* the message read last */
static size_t line_size;

/* The value of a key in the message read last; NULL if it has none. Our keys do not occur within its texts. */
static const char *value_of(const char *key)
{
    char quoted[64];
    snprintf(quoted, sizeof quoted, "\"%s\":", key);
    const char *found = strstr(line, quoted);
    return found ? found + strlen(quoted) : NULL;
}

/* The number of a key in the message read last; NaN if it has none. */
static double number_of(const char *key)
{
    const char *found = value_of(key);
    return found ? strtod(found, NULL) : (double)NAN;
}

/* Read messages until one of the given type; an error of the server ends the program. */
static void read_until(const char *type)
{
    char wanted[64];
    snprintf(wanted, sizeof wanted, "\"type\":\"%s\"", type);
    while (getline(&line, &line_size, from_server) > 0) {
        if (strstr(line, wanted)) return;
        if (strstr(line, "\"type\":\"error\"")) break;
    }
    fprintf(stderr, "no %s: %s\n", type, line ? line : "the server closed the connection");
    exit(EXIT_FAILURE);
}

static void connect_to(const char *host, const char *port)
{
    struct addrinfo hints = {.ai_socktype = SOCK_STREAM}, *found;
    int failed = getaddrinfo(host, port, &hints, &found);
    if (failed) {
        fprintf(stderr, "%s: %s\n", host, gai_strerror(failed));
        exit(EXIT_FAILURE);
    }
    int server = socket(found->ai_family, found->ai_socktype, found->ai_protocol);
    if (server < 0 || connect(server, found->ai_addr, found->ai_addrlen) < 0) {
        perror("cannot connect");
        exit(EXIT_FAILURE);
    }
    freeaddrinfo(found);
    from_server = fdopen(server, "r");
    to_server = fdopen(dup(server), "w");
    if (!from_server || !to_server) {
        perror("cannot use the connection");
        exit(EXIT_FAILURE);
    }
}

/* Angle, in degrees, of the rotation between two attitudes: unit quaternions x, y, z, w. */
static double angle_deg(const double a[4], const double b[4])
{
    double x = a[3] * b[0] - a[0] * b[3] + a[1] * b[2] - a[2] * b[1];
    double y = a[3] * b[1] - a[1] * b[3] + a[2] * b[0] - a[0] * b[2];
    double z = a[3] * b[2] - a[2] * b[3] + a[0] * b[1] - a[1] * b[0];
    double w = a[0] * b[0] + a[1] * b[1] + a[2] * b[2] + a[3] * b[3];
    return 2.0 * atan2(sqrt(x * x + y * y + z * z), fabs(w)) * 180.0 / PI;
}

int main(int count, char **arguments)
{
    if (count != 4) {
        fprintf(stderr, "usage: %s HOST PORT FRAMES\n", arguments[0]);
        return EXIT_FAILURE;
    }
    connect_to(arguments[1], arguments[2]);
    const char *token = getenv("BORESIGHT_TOKEN");
    fprintf(to_server, "{\"type\":\"hello\",\"protocol\":1,\"token\":\"%s\"}\n", token ? token : "");
    fprintf(to_server, "{\"type\":\"subscribe\",\"channels\":[\"solution\"]}\n");
    fprintf(to_server, "{\"type\":\"command\",\"name\":\"source\",\"attitude\":\"external\",\"lockstep\":true,\"id\":1}\n");
    fflush(to_server);
    read_until("welcome");
    const double step_s = number_of("step_s");
    do read_until("reply"); while (number_of("id") != 1.0);

    const double rate_deg_s = 0.05; /* about the camera's x axis, from RA 90, Dec 0 */
    for (int frame = 0; frame < atoi(arguments[3]); frame++) {
        double half = 0.5 * (-90.0 + rate_deg_s * frame * step_s) * PI / 180.0;
        double sent[4] = {sin(half), 0.0, 0.0, cos(half)}, solved[4];
        fprintf(to_server, "{\"type\":\"attitude\",\"t_s\":%.9g,\"quaternion\":[%.17g,%.17g,%.17g,%.17g],"
                "\"rate_deg_s\":[%.9g,0,0]}\n", frame * step_s, sent[0], sent[1], sent[2], sent[3], rate_deg_s);
        fflush(to_server);
        do read_until("solution"); while (fabs(number_of("t_s") - frame * step_s) > 1e-6);
        const char *given = strstr(line, "\"status\":\"solved\"") ? value_of("quaternion") : NULL;
        if (given && sscanf(given, "[%lf,%lf,%lf,%lf]", solved, solved + 1, solved + 2, solved + 3) == 4)
            printf("%3d  error %7.3f arcsec\n", frame, 3600.0 * angle_deg(sent, solved));
        else
            printf("%3d  not solved\n", frame);
    }
    free(line);
    fclose(to_server);
    fclose(from_server);
    return EXIT_SUCCESS;
}
